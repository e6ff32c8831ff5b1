"""The group dance (Source: thesis table 6.3).

Usage: EAL_FLEET=fleets/sim.yaml dance.py HOST...

Departs from table 6.3: `sendCmd` waits for the end of a step here, so the program needs no sleep, and its robots step
one after the other. In `scenarios/dance.py` they step at the same time.
"""

import sys

from eal_actors.classic import EAL, EALconnect, EALdisconnect

DANCE = ["r45", "l90", "r90", "l10", "r10", "l10", "r360"]


def main(argv: list[str]) -> int:
    """Return 0."""
    # arguments are hostnames
    if len(argv) < 2:
        return 0

    # connect to robots
    client: list[EAL | None] = []
    id: list[int] = []  # noqa: A001
    for host in argv[1:]:
        robot = EALconnect(host, 50000)
        client.append(robot)
        id.append(robot.findResource("Base") if robot else -1)

    # do the dance
    for step in DANCE:
        for robot, base in zip(client, id, strict=True):
            if robot is None:
                continue
            robot.sendCmd(base, step, None)

    # disconnect each client
    for robot in client:
        if robot:
            EALdisconnect(robot)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv))
