"""What faults do to the resources of a robot: one place for all of them."""

from __future__ import annotations

import types
from collections.abc import Callable
from typing import Any, Final, TypeVar

import numpy as np

from eal_actors.plugin import Activity, EALData, ResourceType, UnavailableError

from ..robot import SimRobot
from .camera import Camera
from .on_robot import OnRobot

_R = TypeVar("_R", bound=OnRobot)
_Method = Callable[..., Any]

_SENSING: Final = ("get_value", "send_req")
_MOVING: Final = ("set_value", "send_cmd")
_SILENCE_S: Final = 60.0
"""How often the silence of a dead robot looks whether it lives again."""


def under_faults(resource: _R, robot: SimRobot) -> _R:
    """Have the answers of a resource pass the faults of its robot; returns the resource itself.

    Its methods are wrapped one by one, not its class: what it says of itself comes from the class.
    """
    kind = type(resource).__name__
    if isinstance(resource, Camera):
        _wrap(resource, ("get_value",), lambda method: _blackened(method, robot))
    if ResourceType.SENSOR in resource.types:
        _wrap(resource, _SENSING, lambda method: _freezing(method, kind, robot))
    _wrap(resource, _MOVING, lambda method: _mortal(method, robot))
    return resource


def _wrap(resource: OnRobot, methods: tuple[str, ...], wrapped: Callable[[_Method], _Method]) -> None:
    for name in methods:
        setattr(resource, name, wrapped(getattr(resource, name)))


def _freezing(method: _Method, sensor: str, robot: SimRobot) -> _Method:
    """Keep the last answers; a sensor that freezes before it was asked keeps its first one."""
    last: dict[tuple[Any, ...], Any] = {}

    def answer(*asked: Any) -> Any:
        if robot.is_dead:
            raise _dead(robot)
        if sensor not in robot.faults.frozen or asked not in last:
            last[asked] = method(*asked)
        return last[asked]

    return answer


def _blackened(method: _Method, robot: SimRobot) -> _Method:
    def picture() -> Any:
        seen = EALData.of(method())
        if not robot.faults.camera_black:
            return seen
        return EALData.of(np.zeros_like(seen.value), unit=seen.unit, frame_id=seen.frame_id, stamp_s=seen.stamp_s)

    return picture


def _mortal(method: _Method, robot: SimRobot) -> _Method:
    def begin(*given: Any) -> Any:
        begun = method(*given)
        return _until_death(begun, robot) if isinstance(begun, types.GeneratorType) else begun

    return begin


def _until_death(activity: Activity, robot: SimRobot) -> Activity:
    """Carry out an activity; if the robot dies meanwhile, nobody hears how it ended."""
    try:
        result = yield from activity
    except UnavailableError:
        if not robot.is_dead:
            raise
        result = None
    if not robot.is_dead:
        return result
    while robot.is_dead:
        yield _SILENCE_S
    raise UnavailableError(f"robot {robot.name!r} was dead meanwhile")


def _dead(robot: SimRobot) -> UnavailableError:
    return UnavailableError(f"robot {robot.name!r} is dead")
