"""Drive one robot in a square, forward and then back along it (thesis §6.2.1), with the concurrent API."""

import argparse

from eal_actors import Fleet, RobotHandle

FORTH = ["g", "r"] * 4
BACK = ["l", "b"] * 4


def drive_square(robot: RobotHandle) -> None:
    """Drive the square; halt the robot at the end, also after an error."""
    base = robot["Base"]
    try:
        for move in [*FORTH, "s", *BACK, "s"]:
            base.send_cmd(move).get()
    finally:
        base.halt().get()


def main() -> None:
    """Read the command line and drive."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="sim")
    parser.add_argument("--robot", help="the robot's name; the fleet's first if left out")
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as fleet:
        robot = fleet[arguments.robot or next(iter(fleet))]
        before = robot["TruePose"].get_value().get().value
        drive_square(robot)
        after = robot["TruePose"].get_value().get().value
        off_m = ((after[0] - before[0]) ** 2 + (after[1] - before[1]) ** 2) ** 0.5
        print(f"{robot.name} came back to {off_m * 1000:.0f} mm from where it started")


if __name__ == "__main__":
    main()
