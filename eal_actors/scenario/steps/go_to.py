"""The step `go_to`: drive to a place in the map frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from typing_extensions import override

from eal_actors.kernel.errors import ScenarioError
from eal_actors.scenario.language.expressions import Namespace
from eal_actors.scenario.language.values import Text, Value
from eal_actors.scenario.steps.call import ResourceArguments, StartStep
from eal_actors.scenario.steps.wording import short_value


class PlaceArguments(ResourceArguments):
    """A place in the map frame."""

    resource: Text = "Base"
    """The base."""
    x_m: Value
    y_m: Value
    yaw_deg: Value | None = None
    """The heading at the place, counter-clockwise from the map's x axis; any if it is missing."""


class MapStep(StartStep):
    """A motion of a base in the map frame: a send_cmd with numbers."""

    @property
    @override
    def method(self) -> str:
        return "send_cmd"

    @override
    def call_words(self, resource: str, fields: Mapping[str, Any]) -> str:
        numbers = fields.get("data", ())
        return " ".join([self.kind, resource, *(f"{number:.3f}" for number in numbers)])


class GoToStep(MapStep):
    """Drive to a place in the map frame, in a straight line; the step is over at rest there."""

    kind = "go_to"
    go_to: PlaceArguments

    @override
    def resolved_fields(self, names: Namespace) -> dict[str, Any]:
        found = super().resolved_fields(names)
        goal = [number_of(found["x_m"], "x_m"), number_of(found["y_m"], "y_m")]
        if found["yaw_deg"] is not None:
            goal.append(math.radians(number_of(found["yaw_deg"], "yaw_deg")))
        return {"cmd": "goto", "data": goal}


def number_of(value: object, what: str) -> float:
    """Return a value of an expression as a finite number.

    Raises:
        ScenarioError: it is none.
    """
    try:
        number = float(value)  # type: ignore[arg-type]  # of a number, also of numpy; anything else raises
    except (TypeError, ValueError):
        number = math.nan
    if isinstance(value, bool | str) or not math.isfinite(number):
        raise ScenarioError(f"{what} must be a finite number, not {short_value(value)}")
    return number
