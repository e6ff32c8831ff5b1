"""Drive a robot in a square, forward and then backward (Source: thesis table 6.1).

Set EAL_FLEET to a fleet file. The argument is the robot's name, if the fleet has several robots.
"""

import sys

from eal_actors.classic import EALconnect, EALdisconnect


def main(argv: list[str]) -> int:
    """Return 0, or 1 when there is no connection."""
    client = EALconnect(argv[1] if len(argv) > 1 else None)
    if client is None:
        print("Error connecting to EAL")
        return 1

    id = client.findResource("Base")  # noqa: A001

    for _ in range(4):
        client.sendCmd(id, "g", None)
        client.sendCmd(id, "r", None)
    client.sendCmd(id, "s", None)

    for _ in range(4):
        client.sendCmd(id, "l", None)
        client.sendCmd(id, "b", None)
    client.sendCmd(id, "s", None)

    EALdisconnect(client)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv))
