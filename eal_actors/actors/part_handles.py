"""Handles of a robot's usual parts: typed calls that encode to the thesis's methods, commands and values.

`robot.base.drive(0.3)` is `robot["Base"].send_cmd("f0.3")`. So every driver of such a part has them, and so do programs
that use the thesis's calls.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from eal_actors.actors.call import Call
from eal_actors.actors.future import Future
from eal_actors.actors.resource_handle import ResourceHandle
from eal_actors.device.data import EALData
from eal_actors.device.localization.pose_estimate import PoseEstimate

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Image = NDArray[np.uint8]
    Distances = NDArray[np.float64]

T = TypeVar("T")

MOTION_TIMEOUT_S: Final = 120.0
"""The default deadline of a motion, in seconds of the fleet's clock."""


class PartHandle:
    """A part of a robot."""

    __slots__ = ("resource",)

    def __init__(self, resource: ResourceHandle) -> None:
        self.resource = resource

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.resource.robot}/{self.resource.name}>"


def heading_rad(yaw_deg: float) -> float:
    """Return a heading in radians, without its full turns: 810 degrees are 90."""
    return math.radians(math.fmod(yaw_deg, 360.0) if math.isfinite(yaw_deg) else yaw_deg)


class BaseHandle(PartHandle):
    """A base with two driven wheels or tracks. Every call returns a future at once; see ResourceHandle for its errors.

    A newer motion replaces a running one, whose future fails with PreemptedError. Angles are in degrees,
    counter-clockwise positive; places are in the map frame. Thread: any; handles may be shared.
    """

    __slots__ = ()

    def drive(self, distance_m: float, *, timeout_s: float = MOTION_TIMEOUT_S) -> Call[int]:
        """Drive straight by a distance; back if it is negative."""
        return self.resource.send_cmd(_command("f", "b", distance_m), timeout_s=timeout_s)

    def turn(self, angle_deg: float, *, timeout_s: float = MOTION_TIMEOUT_S) -> Call[int]:
        """Turn in place by an angle: to the left, or to the right if it is negative."""
        return self.resource.send_cmd(_command("l", "r", angle_deg), timeout_s=timeout_s)

    def go_to(
        self, x_m: float, y_m: float, yaw_deg: float | None = None, *, timeout_s: float = MOTION_TIMEOUT_S
    ) -> Call[int]:
        """Drive to a place in the map frame, in a straight line; then turn to a heading, if one is given.

        It fails with BlockedError if something is in the way for 5 s, and with LocalizationError if the pose is too old
        or too uncertain; the robot stands then.
        """
        goal = [float(x_m), float(y_m)] + ([] if yaw_deg is None else [heading_rad(yaw_deg)])
        return self.resource.send_cmd("goto", goal, timeout_s=timeout_s)

    def follow(self, path: Iterable[tuple[float, float]], *, timeout_s: float = MOTION_TIMEOUT_S) -> Call[int]:
        """Drive along waypoints (x_m, y_m) to the last one; it turns in place at corners. Errors as in `go_to`."""
        return self.resource.send_cmd("follow", [float(part) for place in path for part in place], timeout_s=timeout_s)

    def set_velocity(self, speed_m_s: float, turn_rate_deg_s: float = 0.0) -> Call[int]:
        """Drive at a speed and a turn rate, until a newer motion or for `twist_timeout_s`, 0.5 s by default."""
        return self.resource.set_value([float(speed_m_s), math.radians(turn_rate_deg_s)])

    def stop(self, *, timeout_s: float | None = None) -> Call[int]:
        """Stop at once, before everything that waits."""
        return self.resource.halt(timeout_s=timeout_s)


class TurretHandle(PartHandle):
    """A turret. Angles are in degrees, counter-clockwise positive. Thread: any; handles may be shared."""

    __slots__ = ()

    def get(self, *, timeout_s: float | None = None) -> Future[float]:
        """Return its angle from straight ahead, in degrees."""
        return self.resource.get_value(timeout_s=timeout_s).map(lambda data: math.degrees(data.value))

    def turn(self, angle_deg: float, *, timeout_s: float = MOTION_TIMEOUT_S) -> Call[int]:
        """Turn by an angle."""
        return self.resource.send_cmd(_command("l", "r", angle_deg), timeout_s=timeout_s)

    def turn_to(self, angle_deg: float, *, timeout_s: float = MOTION_TIMEOUT_S) -> Call[int]:
        """Turn to an angle from straight ahead, in the shorter direction."""
        return self.resource.send_cmd(_command("t", "t-", angle_deg), timeout_s=timeout_s)

    def stop(self, *, timeout_s: float | None = None) -> Call[int]:
        """Stop at once."""
        return self.resource.halt(timeout_s=timeout_s)


class PoseHandle(PartHandle):
    """The estimated pose of the robot in the map frame. Thread: any; handles may be shared."""

    __slots__ = ()

    def get(self, *, timeout_s: float | None = None) -> Future[PoseEstimate]:
        """Return the pose with its covariance and its time."""
        return self.resource.send_req("estimate", timeout_s=timeout_s).map(
            lambda data: PoseEstimate.of_numbers(data.value, data.stamp_s or 0.0)
        )

    def set(self, x_m: float, y_m: float, yaw_deg: float, *, timeout_s: float | None = None) -> Call[int]:
        """Set the estimate: the robot is there now."""
        return self.resource.set_value([float(x_m), float(y_m), heading_rad(yaw_deg)], timeout_s=timeout_s)


class CameraHandle(PartHandle):
    """A camera. Thread: any; handles may be shared."""

    __slots__ = ()

    def frame(self, *, timeout_s: float | None = None) -> Future[Image]:
        """Return a new picture: RGB, shape (height, width, 3), rows from the top."""
        return self.resource.get_value(timeout_s=timeout_s).map(_value)


class SensorHandle(PartHandle, Generic[T]):
    """A sensor with values of one type. Thread: any; handles may be shared."""

    __slots__ = ()

    def get(self, *, timeout_s: float | None = None) -> Future[T]:
        """Return the value."""
        return self.resource.get_value(timeout_s=timeout_s).map(_value)


class RobotParts:
    """The usual parts of a robot, as typed handles; for RobotHandle.

    A part is found when it is used: a robot without it raises ResourceNotFoundError.
    """

    __slots__ = ()

    if TYPE_CHECKING:

        def __getitem__(self, name: str) -> ResourceHandle: ...

    @property
    def base(self) -> BaseHandle:
        """The base: drives, turns, goes to places."""
        return BaseHandle(self["Base"])

    @property
    def pose(self) -> PoseHandle:
        """The estimated pose in the map frame."""
        return PoseHandle(self["Pose"])

    @property
    def camera(self) -> CameraHandle:
        """The camera."""
        return CameraHandle(self["Camera"])

    @property
    def turret(self) -> TurretHandle:
        """The turret."""
        return TurretHandle(self["Turret"])

    @property
    def battery(self) -> SensorHandle[float]:
        """The charge of the battery, 0 to 1."""
        return SensorHandle(self["Battery"])

    @property
    def bump(self) -> SensorHandle[bool]:
        """Whether something touches the bumper."""
        return SensorHandle(self["Bump"])

    @property
    def cliff(self) -> SensorHandle[bool]:
        """Whether the floor falls away in front."""
        return SensorHandle(self["Cliff"])

    @property
    def ranges(self) -> SensorHandle[Distances]:
        """The distances around the robot in metres, the first ahead, then to the left: its resource Range."""
        return SensorHandle(self["Range"])

    @property
    def lidar(self) -> SensorHandle[Distances]:
        """The distances that the lidar measures, in metres."""
        return SensorHandle(self["Lidar"])

    @property
    def compass(self) -> SensorHandle[float]:
        """The yaw in radians, counter-clockwise from the map's x axis."""
        return SensorHandle(self["Compass"])

    @property
    def odometry(self) -> SensorHandle[Distances]:
        """The pose by odometry: x in m, y in m and yaw in rad by the encoders, from the robot's start."""
        return SensorHandle(self["Odometry"])


def _command(forward: str, back: str, amount: float) -> str:
    """Return a command with an amount in its text, by the amount's sign."""
    return f"{back if amount < 0 else forward}{abs(amount):.6f}".rstrip("0").rstrip(".")


def _value(data: EALData) -> Any:
    return data.value
