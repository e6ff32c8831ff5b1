"""The base class of the resources of a simulated robot, and the effect of injected faults on them."""

from __future__ import annotations

import types
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, Final, TypeVar

from eal_actors.plugin import Activity, EALData, Resource, ResourceFaultError, ResourceType, UnavailableError

from ..robot import SimRobot
from ..world import SimWorld

_R = TypeVar("_R", bound=Resource)
_REVIVAL_POLL_S: Final = 60.0
"""Poll interval of an interrupted activity of a dead robot, until the robot is alive again."""


class RobotResource(Resource):
    """A resource of one robot of the world.

    Args:
        world: the world of the robot.
        robot: the robot.

    Attributes:
        settings_key: the plugin's setting that the robot must have for this resource, passed to the class as its third
            argument; None for resources that need none.
    """

    settings_key: ClassVar[str | None] = None
    any_thread = True

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        self._world = world
        self._robot = robot

    def _read(self, sense: Callable[[float], Any], unit: str | None = None, frame: str | None = None) -> EALData:
        """Return a reading of the up-to-date world, with its time.

        Args:
            sense: returns the reading from the world's time in seconds.
            unit: its unit.
            frame: its frame on the robot, such as `base`.
        """
        with self._world.caught_up() as now_s:
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
        setattr(resource, method, partial(_actuate, robot, getattr(resource, method), name))
    return resource


def _freezable(method: Callable[..., Any], sensor: str, robot: SimRobot) -> Callable[..., Any]:
    """Wrap a method to repeat its last answers while the sensor is frozen; without one, it answers once more."""
    last: dict[tuple[Any, ...], Any] = {}

    def answer(*args: Any) -> Any:
        if robot.is_dead:
            raise UnavailableError(f"robot {robot.name!r} is dead")
        _require_working(robot, sensor)
        if sensor not in robot.faults.frozen or args not in last:
            last[args] = method(*args)
        return last[args]

    return answer


def _require_working(robot: SimRobot, resource: str) -> None:
    """Raise ResourceFaultError if an injected fault lets a resource fail."""
    if resource in robot.faults.failing:
        raise ResourceFaultError(f"injected fault: {resource} fails")


def _actuate(robot: SimRobot, method: Callable[..., Any], actuator: str, *args: Any) -> Any:
    """Call a method of an actuator. If the robot dies during the activity, its result is lost."""
    _require_working(robot, actuator)
    begun = method(*args)
    return _run_while_alive(robot, begun, actuator) if isinstance(begun, types.GeneratorType) else begun


def _run_while_alive(robot: SimRobot, activity: Activity, actuator: str) -> Activity:
    try:
        result = yield from activity
    except UnavailableError:
        _require_working(robot, actuator)
        if not robot.is_dead:
            raise
        result = None
    _require_working(robot, actuator)
    if not robot.is_dead:
        return result
    while robot.is_dead:
        yield _REVIVAL_POLL_S
    raise UnavailableError(f"robot {robot.name!r} was dead meanwhile")
