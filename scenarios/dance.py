"""The group dance (thesis §6.2.3): all robots step at the same time and wait for each other after each step."""

import argparse

from eal_actors import EALError, Fleet, RobotHandle, gather

DANCE = ["r45", "l90", "r90", "l10", "r10", "l10", "r360"]


def dance(robots: list[RobotHandle]) -> list[str]:
    """Dance without the robots that fail a step; return the names of those that finish."""
    dancers = list(robots)
    for move in DANCE:
        steps = [robot["Base"].send_cmd(move) for robot in dancers]
        outcomes = gather(steps, return_exceptions=True).get()
        for robot, outcome in zip(list(dancers), outcomes, strict=True):
            if isinstance(outcome, EALError):
                print(f"{robot.name} leaves the dance at {move}: {outcome}")
                robot.halt().exception()  # it may be out of reach
                dancers.remove(robot)
    return [robot.name for robot in dancers]


def main() -> None:
    """Read the command line and dance."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="sim")
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as fleet:
        print(f"finished the dance: {', '.join(dance(list(fleet.values())))}")


if __name__ == "__main__":
    main()
