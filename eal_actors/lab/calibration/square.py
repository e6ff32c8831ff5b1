"""Kinematics of a differential base that drives a square. All functions are pure."""

from __future__ import annotations

import math
from typing import Final, Literal, TypeAlias

from eal_actors.device.differential_base import NOMINAL, WheelCalibration

Pose: TypeAlias = tuple[float, float, float]
"""x and y in metres, yaw in radians, counter-clockwise and unwrapped."""
Way: TypeAlias = Literal["cw", "ccw"]
"""Direction of a square: clockwise, with turns to the right, or counter-clockwise."""

WAYS: Final[tuple[Way, Way]] = ("cw", "ccw")
LEGS: Final = 4
START: Final[Pose] = (0.0, 0.0, 0.0)


def square_end(
    way: Way, side_m: float, wheelbase_m: float, truth: WheelCalibration, applied: WheelCalibration = NOMINAL
) -> Pose:
    """Return the pose after four sides and four quarter turns from (0, 0, 0), the first side along x.

    Args:
        way: direction of the square.
        side_m: length of a side.
        wheelbase_m: nominal distance of the wheels.
        truth: the true calibration of the wheels.
        applied: the calibration that the base uses.
    """
    arm_m = wheelbase_m / 2
    quarter_m = math.pi / 2 * arm_m * (1.0 if way == "ccw" else -1.0)
    side = truth.travelled(*applied.counted(side_m, 0.0))
    turn = truth.travelled(*applied.counted(0.0, quarter_m))
    pose = START
    for _ in range(LEGS):
        for ahead_m, arc_m in (side, turn):
            pose = along_arc(pose, ahead_m, arc_m / arm_m)
    return pose


def along_arc(pose: Pose, ahead_m: float, turn_rad: float) -> Pose:
    """Return the pose after an arc of a length and a turn at constant curvature."""
    x_m, y_m, yaw_rad = pose
    half_rad = turn_rad / 2
    chord_m = ahead_m * math.sin(half_rad) / half_rad if half_rad else ahead_m
    heading_rad = yaw_rad + half_rad
    return x_m + chord_m * math.cos(heading_rad), y_m + chord_m * math.sin(heading_rad), yaw_rad + turn_rad


def seen_from(start: Pose, pose: Pose) -> Pose:
    """Return a pose in the frame of `start`; yaw in (-pi, pi]."""
    east_m, north_m = pose[0] - start[0], pose[1] - start[1]
    cosine, sine = math.cos(start[2]), math.sin(start[2])
    yaw_rad = math.pi - (math.pi - (pose[2] - start[2])) % math.tau
    return east_m * cosine + north_m * sine, north_m * cosine - east_m * sine, yaw_rad
