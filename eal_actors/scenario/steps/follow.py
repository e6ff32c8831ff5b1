"""The step `follow`: drive along waypoints in the map frame."""

from __future__ import annotations

from typing import Any

from typing_extensions import override

from eal_actors.kernel.errors import ScenarioError
from eal_actors.scenario.language.expressions.evaluation import Namespace
from eal_actors.scenario.language.values import Value
from eal_actors.scenario.language.wording import short_value
from eal_actors.scenario.steps.go_to import BaseArguments, MapStep
from eal_actors.scenario.steps.places import number_of


class PathArguments(BaseArguments):
    """A path in the map frame."""

    path_m: Value
    """The waypoints, each [x, y]."""


class FollowStep(MapStep, kind="follow"):
    """Drive along waypoints in the map frame; the step is over at rest at the last one."""

    follow: PathArguments

    @override
    def resolved_fields(self, names: Namespace) -> dict[str, Any]:
        path = super().resolved_fields(names)["path_m"]
        if not isinstance(path, list | tuple) or not path:
            raise ScenarioError(f"path_m must be a list of waypoints [x, y], not {short_value(path)}")
        for point in path:
            if not isinstance(point, list | tuple) or len(point) != 2:
                raise ScenarioError(f"a waypoint must be [x, y], not {short_value(point)}")
        return {"cmd": "follow", "data": [number_of(number, "a waypoint") for point in path for number in point]}
