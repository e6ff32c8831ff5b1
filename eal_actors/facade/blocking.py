"""The synchronous twins of the typed handles: each call waits for its value."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Concatenate, Generic, ParamSpec, TypeVar

from eal_actors.actors.future import Future
from eal_actors.actors.part_handles import BaseHandle, CameraHandle, PoseHandle, SensorHandle, TurretHandle

if TYPE_CHECKING:
    from eal_actors.actors.handles import RobotHandle
    from eal_actors.actors.part_handles import Distances

H = TypeVar("H")
P = ParamSpec("P")
T = TypeVar("T")


class _Part(Generic[H]):
    """A part of a connected robot.

    `find` returns its handle, and raises UnavailableError once the connection is closed.
    """

    __slots__ = ("_find",)

    def __init__(self, find: Callable[[], H]) -> None:
        self._find = find


def _waiting(method: Callable[Concatenate[H, P], Future[T]]) -> Callable[Concatenate[_Part[H], P], T]:
    """Return the twin of a handle's method: with the same arguments, it waits for the value."""

    @wraps(method)
    def wait(part: _Part[H], /, *args: P.args, **kwargs: P.kwargs) -> T:
        return method(part._find(), *args, **kwargs).get()  # noqa: SLF001  # a method of it

    signature = inspect.signature(method)
    returns = signature.return_annotation.partition("[")[2].removesuffix("]")  # of `Future[...]`
    wait.__signature__ = signature.replace(return_annotation=returns)  # type: ignore[attr-defined]  # for `help`
    return wait


class BlockingBase(_Part[BaseHandle]):
    """A base with two driven wheels or tracks; see BaseHandle. Each call waits for the end of its motion.

    Thread: any may call `stop` while another waits for a motion.
    """

    __slots__ = ()

    drive = _waiting(BaseHandle.drive)
    turn = _waiting(BaseHandle.turn)
    go_to = _waiting(BaseHandle.go_to)
    follow = _waiting(BaseHandle.follow)
    set_velocity = _waiting(BaseHandle.set_velocity)
    stop = _waiting(BaseHandle.stop)


class BlockingTurret(_Part[TurretHandle]):
    """A turret; see TurretHandle."""

    __slots__ = ()

    get = _waiting(TurretHandle.get)
    turn = _waiting(TurretHandle.turn)
    turn_to = _waiting(TurretHandle.turn_to)
    stop = _waiting(TurretHandle.stop)


class BlockingPose(_Part[PoseHandle]):
    """The estimated pose of the robot in the map frame."""

    __slots__ = ()

    get = _waiting(PoseHandle.get)
    set = _waiting(PoseHandle.set)


class BlockingCamera(_Part[CameraHandle]):
    """A camera."""

    __slots__ = ()

    frame = _waiting(CameraHandle.frame)


class BlockingSensor(_Part[SensorHandle[T]], Generic[T]):
    """A sensor with values of one type."""

    __slots__ = ()

    def get(self, *, timeout_s: float | None = None) -> T:
        """Return the value."""
        return self._find().get(timeout_s=timeout_s).get()


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
