"""Drive a robot in a square, forward and then backward (Source: thesis table 6.1).

Usage: EAL_FLEET=sim square.py [ROBOT], where ROBOT is needed if the fleet has several robots.
"""

import sys

from eal_actors.classic import EALconnect, EALdisconnect


def main(argv: list[str]) -> int:
    """Return 0, or 1 when a call failed."""
    client = EALconnect(argv[1] if len(argv) > 1 else None)
    if client is None:
        print("Error connecting to EAL", file=sys.stderr)
        return 1

    id = client.findResource("Base")  # noqa: A001

    for step in ["g", "r"] * 4 + ["s"] + ["l", "b"] * 4 + ["s"]:
        if client.sendCmd(id, step, None) < 0:
            print(f"The robot cannot {step!r}", file=sys.stderr)
            EALdisconnect(client)
            return 1

    EALdisconnect(client)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv))
