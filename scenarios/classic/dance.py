"""The group dance (Source: thesis §6.2.3, table 6.3).

Usage: EAL_FLEET=sim dance.py HOST...

Departs from table 6.3: `sendCmd` waits for the end of a step here, so each step has a task for each robot, which
replaces the program's sleep. A robot that fails a step leaves the dance.
"""

import sys

from eal_actors.classic import EAL, EALconnect, EALdisconnect

DANCE = ["r45", "l90", "r90", "l10", "r10", "l10", "r360"]


def dance(clients: dict[str, EAL]) -> list[str]:
    """Dance; return the hosts of the robots that finish."""
    id = {host: client.findResource("Base") for host, client in clients.items()}  # noqa: A001
    dancers = list(clients)
    try:
        for step in DANCE:
            # all robots step at the same time; the next step waits for the slowest
            with clients[dancers[0]].tasks() as tasks:
                statuses = {host: tasks.start(clients[host].sendCmd, id[host], step, None) for host in dancers}
            dancers = [host for host in dancers if statuses[host].get() > 0]
            if not dancers:
                break
    finally:
        for client in clients.values():
            EALdisconnect(client)  # after Ctrl-C this stops the robots
    return dancers


def main(argv: list[str]) -> int:
    """Return 0; 1 when a robot could not be reached or failed; 2 for a wrong command line."""
    # arguments are hostnames
    if len(argv) < 2:
        print(__doc__, file=sys.stderr)
        return 2

    # connect to robots
    clients = {host: client for host in argv[1:] if (client := EALconnect(host, 50000)) is not None}

    finished = dance(clients) if clients else []
    print(f"finished the dance: {', '.join(finished) or 'none'}")
    return 0 if finished == argv[1:] else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv))
