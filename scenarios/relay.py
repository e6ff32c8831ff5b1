"""One robot at a time goes round a circle, until its stream of battery values says low: relay.yaml in Python."""

import argparse
import math
from collections.abc import Sequence

from eal_actors import Fleet, RobotHandle
from eal_actors.kernel.errors import UnavailableError
from eal_actors.lab.choreography.aiming import leg_commands

RADIUS_M, MIDDLE = 2.5, (0.0, 0.4)
MARKS = 12
LOW = 0.2
NEAR_M, LONGEST_M, MOST_LEGS = 0.05, 1.0, 200


def mark(number: int) -> tuple[float, float]:
    """Return where a mark of the circle is, counted on from lap to lap."""
    angle_rad = 2 * math.pi * number / MARKS - math.pi / 2
    return MIDDLE[0] + RADIUS_M * math.cos(angle_rad), MIDDLE[1] + RADIUS_M * math.sin(angle_rad)


def go_to(robot: RobotHandle, goal: tuple[float, float]) -> None:
    """Drive to a point, aiming again after every metre, for wheels err.

    Raises:
        UnavailableError: the robot does not get there.
    """
    for _ in range(MOST_LEGS):
        pose = robot["Pose"].get_value().get().value
        if math.dist(pose[:2], goal) <= NEAR_M:
            return
        for command in leg_commands(pose, goal, LONGEST_M):
            robot["Base"].send_cmd(command).get()
    raise UnavailableError(f"does not get to {goal} in {MOST_LEGS} legs", robot=robot.name)


def run_with(robot: RobotHandle, done: int, total: int) -> int:
    """Let a robot go on from a mark until its battery is low, and go home; return how many marks are done then."""
    home_x_m, home_y_m, _ = robot["Pose"].get_value().get().value
    try:
        with robot["Battery"].stream(rate_hz=2) as charge:
            while done < total and next(charge).value > LOW:
                go_to(robot, mark(done))
                done += 1
        go_to(robot, (home_x_m, home_y_m))  # off the circle before the next one sets out
    finally:
        robot.halt().get()
    return done


def relay(robots: Sequence[RobotHandle], laps: int) -> dict[str, int]:
    """Go round with one robot after the other; return how many marks each did, by name."""
    total, done = laps * MARKS, 0
    marks: dict[str, int] = {}
    for robot in robots:
        before, done = done, run_with(robot, done, total)
        marks[robot.name] = done - before
    return marks


def main() -> None:
    """Read the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="fleets/relay.yaml")
    parser.add_argument("--laps", type=int, default=2)
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as fleet:
        marks = relay(list(fleet.values()), arguments.laps)
    for name, number in marks.items():
        print(f"{name}: {number} marks")
    if sum(marks.values()) < arguments.laps * MARKS:
        print(f"every battery is low after {sum(marks.values())} of {arguments.laps * MARKS} marks")


if __name__ == "__main__":
    main()
