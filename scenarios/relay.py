"""One robot at a time drives round a circle until its battery is low: relay.yaml in Python."""

import argparse
import math
from functools import partial

from eal_actors import Fleet, RobotHandle
from eal_actors.lab.choreography.aiming import drive_to

RADIUS_M, X_M, Y_M, MARKS = 2.5, 0.0, 0.4, 12
LOW, NEAR_M = 0.2, 0.05


def run_from(robot: RobotHandle, done: int, total: int) -> int:
    """Drive from mark to mark until the battery is low, then home; return the number of marks done by then."""
    home_x_m, home_y_m, _ = robot["TruePose"].get_value().get().value
    with robot["Battery"].stream(rate_hz=2) as charge:
        while done < total and next(charge).value > LOW:
            angle_rad = 2 * math.pi * done / MARKS - math.pi / 2
            drive_to(robot, (X_M + RADIUS_M * math.cos(angle_rad), Y_M + RADIUS_M * math.sin(angle_rad)), NEAR_M)
            done += 1
    drive_to(robot, (home_x_m, home_y_m), NEAR_M)  # off the circle before the next robot starts
    return done


def relay(fleet: Fleet, laps: int) -> dict[str, int]:
    """Drive round with one robot after the other; return how many marks each did."""
    marks: dict[str, int] = {}
    for name in fleet:
        before = sum(marks.values())
        after = fleet.each([name], partial(run_from, done=before, total=laps * MARKS))  # halts the robot if it fails
        marks[name] = after[name] - before
    return marks


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="fleets/relay.yaml")
    parser.add_argument("--laps", type=int, default=2)
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as runners:
        marks = relay(runners, arguments.laps)
    print(f"{sum(marks.values())} of {arguments.laps * MARKS} marks: {marks}")
