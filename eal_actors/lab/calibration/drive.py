"""Driving and measuring squares with a robot's base."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Final

from typing_extensions import override

from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.device.data import EALData
from eal_actors.device.differential_base import WheelCalibration
from eal_actors.device.localization.pose_estimate import Point, Pose
from eal_actors.device.localization.pose_filter import between
from eal_actors.kernel.errors import BlockedError, UnsupportedError
from eal_actors.lab.calibration.square import LEGS, START, WAYS, SquareEnds, Way

BASE: Final = "Base"
_TRUTH: Final = "TruePose"
_ODOMETRY: Final = "Odometry"
_BUMP: Final = "Bump"
_SLOWEST_M_S: Final = 0.05  # slowest speed of a side; the deadline of a side follows from it
_TURN_S: Final = 60.0  # deadline of a quarter turn
_QUARTERS: Final[dict[Way, str]] = {"cw": "r90", "ccw": "l90"}


class SquareMeasurement(ABC):
    """Measurement of where a robot ends its squares."""

    @abstractmethod
    def prepare(self, way: Way, number: int) -> None:
        """Place the robot at its start, the first side ahead; `number` counts the squares of a way from 1."""

    @abstractmethod
    def measure(self, way: Way, number: int) -> Point:
        """Return the robot's position after a square, relative to its start: x ahead and y to the left, in metres."""


class GroundTruth(SquareMeasurement):
    """Measurement of a simulated robot, which its resource TruePose also puts back to the start."""

    def __init__(self, robot: RobotHandle) -> None:
        self._pose = robot[_TRUTH]
        self._start = _pose_of(self._pose)

    @override
    def prepare(self, way: Way, number: int) -> None:
        self._pose.set_value(list(self._start)).get()

    @override
    def measure(self, way: Way, number: int) -> Point:
        return between(self._start, _pose_of(self._pose))[:2]


def has_ground_truth(robot: RobotHandle) -> bool:
    """Return whether a robot is simulated: its resource TruePose gives its true pose and can change it."""
    return _TRUTH in robot


def drive_squares(
    robot: RobotHandle,
    measurement: SquareMeasurement,
    side_m: float,
    count: int,
    on_end: Callable[[Way, int, Point], None] = lambda *_: None,
) -> SquareEnds:
    """Drive squares from one start, first clockwise, then counter-clockwise, and measure their ends.

    The position by odometry, if the robot has it, is subtracted from each end: a motion that stops a little early is
    not an error of the wheels. Its Base has the commands f<metres>, l<degrees> and r<degrees>. `on_end` is called with
    each end, in metres.

    Raises:
        BlockedError: the robot touches something.
        EALError: a call failed; the base is halted in every case.

    Thread: blocks the caller.
    """
    base, ends = robot[BASE], {way: list[Point]() for way in WAYS}
    try:
        for way in WAYS:
            for number in range(1, count + 1):
                measurement.prepare(way, number)
                believed = _drive_square(robot, base, side_m, way)
                x_m, y_m = measurement.measure(way, number)
                ends[way].append((x_m - believed[0], y_m - believed[1]))
                on_end(way, number, ends[way][-1])
    finally:
        base.halt().get()
    return SquareEnds(ends["cw"], ends["ccw"])


def _drive_square(robot: RobotHandle, base: ResourceHandle, side_m: float, way: Way) -> Pose:
    """Drive one square; return its end by odometry, relative to its start."""
    odometry = robot.get(_ODOMETRY)
    if odometry is not None:
        odometry.set_value(list(START)).get()
    for leg in range(1, LEGS + 1):
        try:
            base.send_cmd(f"f{side_m:g}", timeout_s=_TURN_S + side_m / _SLOWEST_M_S).get()
            is_blocked = _BUMP in robot and bool(robot[_BUMP].get_value().get().value)
        except BlockedError:
            is_blocked = True
        if is_blocked:
            raise BlockedError(f"touches something on side {leg} of a square {way}: clear the floor").at(robot.name)
        base.send_cmd(_QUARTERS[way], timeout_s=_TURN_S).get()
    return START if odometry is None else _pose_of(odometry)


def _pose_of(resource: ResourceHandle) -> Pose:
    x_m, y_m, yaw_rad = (float(part) for part in resource.get_value().get().value)
    return x_m, y_m, yaw_rad


def wheelbase_of(robot: RobotHandle) -> float | None:
    """Return the nominal distance of a robot's wheels, in metres; None if its base has no `wheelbase_m`."""
    return _config(robot, "wheelbase_m")


def calibration_of_base(robot: RobotHandle) -> WheelCalibration | None:
    """Return the calibration that a robot's base uses; None if the base cannot be calibrated."""
    known = {name: _config(robot, name) for name in WheelCalibration.model_fields}
    return None if None in known.values() else WheelCalibration.model_validate(known)


def calibrate_base(robot: RobotHandle, calibration: WheelCalibration) -> None:
    """Set the calibration of a base until it restarts; raise UnsupportedError if the base has no such configuration."""
    for name, value in calibration.model_dump().items():
        if _config(robot, name) is None:
            raise UnsupportedError(f"has no configuration {name}: it cannot be calibrated").at(robot.name, BASE)
        robot[BASE].set_config(name, value).get()


def _config(robot: RobotHandle, name: str) -> float | None:
    base = robot[BASE]
    if name not in {known.name for known in base.info.configs}:
        return None
    answer: Any = base.get_config(name).get()
    return float(answer.value if isinstance(answer, EALData) else answer)
