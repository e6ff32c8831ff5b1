"""The base class of the resources of a simulated robot, and the effect of injected faults on them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, TypeVar

from eal_actors.plugin import EALData, Resource, ResourceType, UnavailableError

from ..faults import HEALTHY
from ..robot import SimRobot
from ..world import SimWorld

_R = TypeVar("_R", bound=Resource)
_V = TypeVar("_V")


class RobotResource(Resource):
    """A resource of one robot of the world.

    Attributes:
        settings_key: the plugin's setting that the robot must have for this resource, passed to the class as its third
            argument; None for resources that need none.
    """

    settings_key: ClassVar[str | None] = None
    any_thread = True

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        self._world = world
        self._robot = robot

    def _sense(self, sense: Callable[[float], _V]) -> tuple[_V, float]:
        """Return a reading of the up-to-date world, and its time; `sense` takes the world's time in seconds."""
        with self._world.lock:
            now_s = self._world.catch_up()
            return sense(now_s), now_s

    def _read(self, sense: Callable[[float], Any], unit: str | None = None, frame: str | None = None) -> EALData:
        """Return a reading of the up-to-date world, with its time; `sense` gets the world's time in seconds."""
        with self._world.lock:  # as _sense, in most readings
            now_s = self._world.catch_up()
            value = sense(now_s)
        return EALData.of(value, unit=unit, frame_id=frame and f"{self._robot.name}/{frame}", stamp_s=now_s)


def apply_faults(resource: _R, robot: SimRobot) -> _R:
    """Make a resource subject to its robot's faults; return the resource itself.

    The methods of the object are wrapped, and not its class, because `info()` reads the class.
    """
    name = type(resource).__name__
    if ResourceType.SENSOR in resource.types:
        for method in ("get_value", "send_req"):
            setattr(resource, method, _freezable(getattr(resource, method), name, robot))
    for method in ("set_value", "send_cmd"):
        setattr(resource, method, partial(robot.actuate, getattr(resource, method), name))
    return resource


def _freezable(method: Callable[..., Any], sensor: str, robot: SimRobot) -> Callable[..., Any]:
    """Wrap a method to repeat its last answers while the sensor is frozen; without one, it answers once more."""
    last: dict[tuple[Any, ...], Any] = {}

    def answer(*args: Any) -> Any:
        if robot.faults is HEALTHY:  # the usual case
            last[args] = found = method(*args)
            return found
        if robot.is_dead:
            raise UnavailableError(f"robot {robot.name!r} is dead")
        robot.require_working(sensor)
        if sensor not in robot.faults.frozen or args not in last:
            last[args] = method(*args)
        return last[args]

    return answer
