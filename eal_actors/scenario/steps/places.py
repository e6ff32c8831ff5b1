"""Places of the steps that send robots somewhere: their values, their checks, and the trips to them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final, TypeAlias

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.facade.traffic.travelling import JOURNEY_TIMEOUT_S
from eal_actors.kernel.errors import EALError, ScenarioError
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.language.expressions.evaluation import Namespace, expressions_in, render
from eal_actors.scenario.language.robot_check import CheckedCall, Location, RobotCheck, RobotScope
from eal_actors.scenario.language.wording import short_value

BASE: Final = "Base"
_GOTO: Final = {"cmd": "goto", "data": [0.0, 0.0]}

Place: TypeAlias = str | tuple[float, ...]
"""The name of a place of the fleet's world, or x_m and y_m, or x_m, y_m and yaw_deg."""


def place_of(value: object) -> Place:
    """Return a value of an expression as a place; raise ScenarioError if it is none."""
    if isinstance(value, str) and value:
        return value
    if isinstance(value, list | tuple) and len(value) in (2, 3):
        return tuple(number_of(number, "a number of a place") for number in value)
    raise ScenarioError(f"a place must be the name of one, [x_m, y_m] or [x_m, y_m, yaw_deg], not {short_value(value)}")


def number_of(value: object, what: str) -> float:
    """Return a value of an expression as a finite number; raise ScenarioError if it is none."""
    try:
        number = float(value)  # type: ignore[arg-type]  # of a number, also of numpy; anything else raises
    except (TypeError, ValueError):
        number = math.nan
    if isinstance(value, bool | str) or not math.isfinite(number):
        raise ScenarioError(f"{what} must be a finite number, not {short_value(value)}")
    return number


def places_of(values: object) -> list[Place]:
    """Return values of expressions as places; raise ScenarioError if they are no list, or one is no place."""
    if not isinstance(values, list | tuple):
        raise ScenarioError(f"places must be a list, not {short_value(values)}")
    return [place_of(value) for value in values]


def place_words(place: Place) -> str:
    """Return a place for people."""
    return place if isinstance(place, str) else f"({', '.join(f'{number:g}' for number in place)})"


def begin_trip(run: RunContext, robot: RobotHandle, place: Place, timeout_s: float | None) -> Future[int]:
    """Send a robot to a place, planned with all others that are on their way; see `Fleet.go_to`.

    Raises EALError if the place is unknown, or the robot cannot drive.
    """
    return run.fleet.go_to({robot: place}, timeout_s=timeout_s or JOURNEY_TIMEOUT_S).arrivals[robot.name]


# Checks.


def check_driving(check: RobotCheck, path: YamlPath, here: RobotScope) -> None:
    """Check that the robots of an `on` can drive to places."""
    at = Location(path)
    for robots in here.groups:
        check.call(CheckedCall.at(at, "send_cmd", BASE, _GOTO), robots, here)
        check.call(CheckedCall.at(at, "get_value", "Pose", {}), robots, here)


def known_places(
    check: RobotCheck, values: Any, path: YamlPath, here: RobotScope
) -> Iterator[tuple[tuple[str, ...], Namespace, list[Place]]]:
    """Yield the robots, variables and places of a list of values, as far as they are known before the run.

    What is no place, names that the fleet's world does not have, and points outside its room are reported.
    """
    expressions = expressions_in(values)
    if not here.are_known(expressions):
        return
    for robots, names in check.combinations(expressions, path, here):
        try:
            places = places_of(render(values, names))
            for place in places:
                check.require_place(place)
        except EALError as error:
            check.report(here, path, error.message, robots if here.values.facts else ())
        else:
            yield robots, names, places
