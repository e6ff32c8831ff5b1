"""Calibration by squares, verified with a second run: square-umbmark.yaml in Python."""

import argparse
from typing import NamedTuple

from eal_actors import Fleet, RobotHandle
from eal_actors.device.differential_base import NOMINAL
from eal_actors.kernel.errors import UnsupportedError
from eal_actors.lab.calibration.drive import (
    GroundTruth,
    calibrate_base,
    calibration_of_base,
    drive_squares,
    has_ground_truth,
    wheelbase_of,
)
from eal_actors.lab.calibration.fit import Fit, fit_squares

SIDE_M, SQUARES = 1.0, 5


class Proof(NamedTuple):
    """The fit, and the errors of the squares before and after it, in m."""

    fit: Fit
    before_m: float
    after_m: float


def prove(robot: RobotHandle, side_m: float = SIDE_M, squares: int = SQUARES) -> Proof:
    """Drive squares, calibrate the base, and drive them again.

    Raises:
        UnsupportedError: the base does not report its wheelbase, or accepts no calibration.
        ResourceFaultError: the robot touches something.
    """
    wheelbase_m = wheelbase_of(robot)
    if wheelbase_m is None:
        raise UnsupportedError("does not report its wheelbase").at(robot.name, "Base")
    truth = GroundTruth(robot)
    before = drive_squares(robot, truth, side_m, squares)
    fit = fit_squares(before, side_m, wheelbase_m, calibration_of_base(robot) or NOMINAL)
    calibrate_base(robot, fit.calibration)
    after = drive_squares(robot, truth, side_m, squares)
    return Proof(fit, before.error_m, after.error_m)


def main() -> None:
    """Read the command line and calibrate the first robot whose true pose is known."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="uncalibrated")
    parser.add_argument("--side", type=float, default=SIDE_M, help="length of a side, in m")
    parser.add_argument("--squares", type=int, default=SQUARES, help="number each way")
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as fleet:
        robot = next(robot for robot in fleet.values() if has_ground_truth(robot))
        proof = prove(robot, arguments.side, arguments.squares)
    wheels = proof.fit.calibration
    print(f"{robot.name}: E_b {wheels.track_factor:.4f}, E_d {wheels.wheel_ratio:.4f}")
    print(f"off by {proof.before_m * 1000:.0f} mm before, and {proof.after_m * 1000:.0f} mm after")


if __name__ == "__main__":
    main()
