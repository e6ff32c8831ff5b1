"""The synchronous twins of the typed handles: each call waits for its value."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Generic, TypeVar

from eal_actors.actors.future import get_or_cancel
from eal_actors.actors.part_handles import (
    MOTION_TIMEOUT_S,
    BaseHandle,
    CameraHandle,
    PoseHandle,
    SensorHandle,
    TurretHandle,
)
from eal_actors.device.localization.pose_estimate import PoseEstimate

if TYPE_CHECKING:
    from eal_actors.actors.handles import RobotHandle
    from eal_actors.actors.part_handles import Distances, Image

T = TypeVar("T")
P = TypeVar("P")


class _Part(Generic[P]):
    """A part of a connected robot.

    Args:
        find: returns its handle; raises UnavailableError once the connection is closed.
    """

    __slots__ = ("_find",)

    def __init__(self, find: Callable[[], P]) -> None:
        self._find = find


class BlockingBase(_Part[BaseHandle]):
    """A base with two driven wheels or tracks; see BaseHandle. Each call waits for the end of its motion."""

    __slots__ = ()

    def drive(self, distance_m: float, *, timeout_s: float = MOTION_TIMEOUT_S) -> int:
        """Drive straight by a distance; back if it is negative."""
        return get_or_cancel(self._find().drive(distance_m, timeout_s=timeout_s))

    def turn(self, angle_deg: float, *, timeout_s: float = MOTION_TIMEOUT_S) -> int:
        """Turn in place by an angle: to the left, or to the right if it is negative."""
        return get_or_cancel(self._find().turn(angle_deg, timeout_s=timeout_s))

    def go_to(
        self, x_m: float, y_m: float, yaw_deg: float | None = None, *, timeout_s: float = MOTION_TIMEOUT_S
    ) -> int:
        """Drive to a place in the map frame, in a straight line; then turn to a heading, if one is given.

        Raises:
            BlockedError: something is in the way for 5 s.
            LocalizationError: the pose is too old or too uncertain.
        """
        return get_or_cancel(self._find().go_to(x_m, y_m, yaw_deg, timeout_s=timeout_s))

    def follow(self, path: Iterable[tuple[float, float]], *, timeout_s: float = MOTION_TIMEOUT_S) -> int:
        """Drive along waypoints (x_m, y_m) to the last one; it turns in place at corners. Raises as `go_to`."""
        return get_or_cancel(self._find().follow(path, timeout_s=timeout_s))

    def set_velocity(self, speed_m_s: float, turn_rate_deg_s: float = 0.0) -> int:
        """Drive at a speed and a turn rate for the base's `twist_timeout_s`, 0.5 s by default; then stop."""
        return get_or_cancel(self._find().set_velocity(speed_m_s, turn_rate_deg_s))

    def stop(self, *, timeout_s: float | None = None) -> int:
        """Stop at once, before everything that waits. Thread: any, while another waits for a motion."""
        return get_or_cancel(self._find().stop(timeout_s=timeout_s))


class BlockingTurret(_Part[TurretHandle]):
    """A turret; see TurretHandle."""

    __slots__ = ()

    def get(self, *, timeout_s: float | None = None) -> float:
        """Return its angle from straight ahead, in degrees."""
        return get_or_cancel(self._find().get(timeout_s=timeout_s))

    def turn(self, angle_deg: float, *, timeout_s: float = MOTION_TIMEOUT_S) -> int:
        """Turn by an angle."""
        return get_or_cancel(self._find().turn(angle_deg, timeout_s=timeout_s))

    def turn_to(self, angle_deg: float, *, timeout_s: float = MOTION_TIMEOUT_S) -> int:
        """Turn to an angle from straight ahead, in the shorter direction."""
        return get_or_cancel(self._find().turn_to(angle_deg, timeout_s=timeout_s))

    def stop(self, *, timeout_s: float | None = None) -> int:
        """Stop at once."""
        return get_or_cancel(self._find().stop(timeout_s=timeout_s))


class BlockingPose(_Part[PoseHandle]):
    """The estimated pose of the robot in the map frame."""

    __slots__ = ()

    def get(self, *, timeout_s: float | None = None) -> PoseEstimate:
        """Return the pose with its covariance and its time."""
        return get_or_cancel(self._find().get(timeout_s=timeout_s))

    def set(self, x_m: float, y_m: float, yaw_deg: float, *, timeout_s: float | None = None) -> int:
        """Set the estimate: the robot is there now."""
        return get_or_cancel(self._find().set(x_m, y_m, yaw_deg, timeout_s=timeout_s))


class BlockingCamera(_Part[CameraHandle]):
    """A camera."""

    __slots__ = ()

    def frame(self, *, timeout_s: float | None = None) -> Image:
        """Return a new picture: RGB, shape (height, width, 3), rows from the top."""
        return get_or_cancel(self._find().frame(timeout_s=timeout_s))


class BlockingSensor(_Part[SensorHandle[T]], Generic[T]):
    """A sensor with values of one type."""

    __slots__ = ()

    def get(self, *, timeout_s: float | None = None) -> T:
        """Return the value."""
        return get_or_cancel(self._find().get(timeout_s=timeout_s))


class BlockingParts:
    """The usual parts of a connected robot; for EAL. A robot without one raises ResourceNotFoundError at its use."""

    def _open_robot(self) -> RobotHandle:
        """Return the robot; raises UnavailableError once the connection is closed."""
        raise NotImplementedError

    @property
    def base(self) -> BlockingBase:
        """The base: drives, turns, goes to places."""
        return BlockingBase(lambda: self._open_robot().base)

    @property
    def pose(self) -> BlockingPose:
        """The estimated pose in the map frame."""
        return BlockingPose(lambda: self._open_robot().pose)

    @property
    def camera(self) -> BlockingCamera:
        """The camera."""
        return BlockingCamera(lambda: self._open_robot().camera)

    @property
    def turret(self) -> BlockingTurret:
        """The turret."""
        return BlockingTurret(lambda: self._open_robot().turret)

    @property
    def battery(self) -> BlockingSensor[float]:
        """The charge of the battery, 0 to 1."""
        return BlockingSensor(lambda: self._open_robot().battery)

    @property
    def bump(self) -> BlockingSensor[bool]:
        """Whether something touches the bumper."""
        return BlockingSensor(lambda: self._open_robot().bump)

    @property
    def cliff(self) -> BlockingSensor[bool]:
        """Whether the floor falls away in front."""
        return BlockingSensor(lambda: self._open_robot().cliff)

    @property
    def ranges(self) -> BlockingSensor[Distances]:
        """The distances around the robot in metres, the first ahead, then to the left: its resource Range."""
        return BlockingSensor(lambda: self._open_robot().ranges)

    @property
    def lidar(self) -> BlockingSensor[Distances]:
        """The distances that the lidar measures, in metres."""
        return BlockingSensor(lambda: self._open_robot().lidar)

    @property
    def compass(self) -> BlockingSensor[float]:
        """The yaw in radians, counter-clockwise from the map's x axis."""
        return BlockingSensor(lambda: self._open_robot().compass)

    @property
    def odometry(self) -> BlockingSensor[Distances]:
        """The pose by odometry: x in m, y in m and yaw in rad by the encoders, from the robot's start."""
        return BlockingSensor(lambda: self._open_robot().odometry)
