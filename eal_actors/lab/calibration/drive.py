"""Squares driven and measured: a robot's base is commanded, and somebody who knows says where it came to stand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Protocol

from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.device.data import EALData
from eal_actors.device.differential_base import WheelCalibration
from eal_actors.kernel.errors import ResourceFaultError, UnsupportedError
from eal_actors.lab.calibration.square import LEGS, START, WAYS, Pose, Way, seen_from
from eal_actors.lab.calibration.umbmark import Point, SquareEnds

BASE: Final = "Base"
_TRUTH: Final = "Pose"
_ODOMETRY: Final = "Odometry"
_BUMP: Final = "Bump"
_SLOWEST_M_S: Final = 0.05
"""A base that drives a side slower than this has missed its deadline."""
_TURN_S: Final = 60.0
"""Deadline of a quarter turn."""
_QUARTERS: Final[dict[Way, str]] = {"cw": "r90", "ccw": "l90"}


class Measurer(Protocol):
    """Who sees where a robot stands."""

    def begin(self, way: Way, number: int) -> None:
        """See that the robot stands at its start, the first side ahead; `number` counts a way's squares from 1."""
        ...

    def end(self, way: Way, number: int) -> Point:
        """Return where it stands after a square, from its start: x ahead and y to the left, in metres."""
        ...


class GroundTruth:
    """Measures a simulated robot, and carries it back to where it stood at first, by its resource Pose."""

    def __init__(self, robot: RobotHandle) -> None:
        self._pose = robot[_TRUTH]
        self._start = _pose_of(self._pose)

    def begin(self, way: Way, number: int) -> None:  # noqa: ARG002  # every square starts at the same place
        """See Measurer."""
        self._pose.set_value(list(self._start)).get()

    def end(self, way: Way, number: int) -> Point:  # noqa: ARG002
        """See Measurer."""
        return seen_from(self._start, _pose_of(self._pose))[:2]


def has_ground_truth(robot: RobotHandle) -> bool:
    """Return whether a robot knows where it truly is, and can be put elsewhere: whether it is simulated."""
    return _TRUTH in robot


def drive_squares(
    robot: RobotHandle,
    measurer: Measurer,
    side_m: float,
    count: int,
    tell: Callable[[Way, int, Point], None] = lambda *_: None,
) -> SquareEnds:
    """Have a robot drive squares from one start, first clockwise, then the other way round, and measure their ends.

    What counts is where it stands less where its odometry believes that it does, if it has one: a motion that stops a
    little early is no error of the wheels.

    Args:
        robot: it has a resource Base with the commands f<metres>, l<degrees> and r<degrees>.
        measurer: who says where it stands.
        side_m: length of a side.
        count: squares each way.
        tell: is told each end, in metres.

    Raises:
        ResourceFaultError: it touches something.
        EALError: a call failed; the base is halted whatever happens.

    Thread: blocks the caller.
    """
    base, ends = robot[BASE], {way: list[Point]() for way in WAYS}
    try:
        for way in WAYS:
            for number in range(1, count + 1):
                measurer.begin(way, number)
                believed = _driven(robot, base, side_m, way)
                x_m, y_m = measurer.end(way, number)
                ends[way].append((x_m - believed[0], y_m - believed[1]))
                tell(way, number, ends[way][-1])
    finally:
        base.halt().get()
    return SquareEnds(ends["cw"], ends["ccw"])


def _driven(robot: RobotHandle, base: ResourceHandle, side_m: float, way: Way) -> Pose:
    """Drive one square; return where the robot believes that it ended, from its start."""
    odometry = robot.get(_ODOMETRY)
    if odometry is not None:
        odometry.set_value(list(START)).get()
    for leg in range(1, LEGS + 1):
        base.send_cmd(f"f{side_m:g}", timeout_s=_TURN_S + side_m / _SLOWEST_M_S).get()
        if _BUMP in robot and robot[_BUMP].get_value().get().value:
            error = ResourceFaultError(f"touches something after side {leg} of a square {way}: clear the floor")
            raise error.at(robot.name)
        base.send_cmd(_QUARTERS[way], timeout_s=_TURN_S).get()
    return START if odometry is None else _pose_of(odometry)


def _pose_of(resource: ResourceHandle) -> Pose:
    x_m, y_m, yaw_rad = (float(part) for part in resource.get_value().get().value)
    return x_m, y_m, yaw_rad


def wheelbase_of(robot: RobotHandle) -> float | None:
    """Return the nominal distance of a robot's wheels, in metres; None if its base does not tell."""
    return _config(robot, "wheelbase_m")


def calibration_of_base(robot: RobotHandle) -> WheelCalibration | None:
    """Return what a robot's base knows of its wheels; None if it cannot know anything."""
    known = {name: _config(robot, name) for name in WheelCalibration.model_fields}
    return None if None in known.values() else WheelCalibration.model_validate(known)


def calibrate_base(robot: RobotHandle, calibration: WheelCalibration) -> None:
    """Tell a robot's base how its wheels are, until it is started anew.

    Raises:
        UnsupportedError: the base has no such configuration.
    """
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
