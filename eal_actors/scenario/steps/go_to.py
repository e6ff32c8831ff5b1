"""The step `go_to`: drive to a place in the map frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, Discriminator, Tag
from typing_extensions import override

from eal_actors.actors.future import Future
from eal_actors.actors.part_handles import heading_rad
from eal_actors.device.info import ResourceInfo
from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.frames import Participant
from eal_actors.scenario.engine.python_functions import StepFunction
from eal_actors.scenario.language.expressions.evaluation import Namespace, expressions_in
from eal_actors.scenario.language.robot_check import RobotCheck, RobotScope
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.values import Text, Value
from eal_actors.scenario.steps.call import ResourceArguments, StartStep
from eal_actors.scenario.steps.for_ import LoopValues
from eal_actors.scenario.steps.places import (
    BASE,
    begin_trip,
    check_driving,
    known_places,
    number_of,
    place_of,
    place_words,
    places_of,
)


class BaseArguments(ResourceArguments):
    """The arguments of a motion of the base."""

    resource: Text = BASE
    """The base."""


class PositionArguments(BaseArguments):
    """A position in the map frame, to which the base drives in a straight line."""

    x_m: Value
    y_m: Value
    yaw_deg: Value | None = None
    """The heading there, counter-clockwise from the map's x axis; any if it is missing."""


class PlaceArguments(BaseArguments):
    """A place, to which the robot drives round obstacles and other robots."""

    place: Value
    """The name of a place of the fleet's world, or [x_m, y_m], or [x_m, y_m, yaw_deg]."""


class PlacesArguments(BaseArguments):
    """The places of all robots of the role, which go there together."""

    places: LoopValues
    """A place for each robot, in the order of the role."""


def _form(value: object) -> str:
    keys = value if isinstance(value, Mapping) else type(value).model_fields if isinstance(value, BaseModel) else ()
    return next((key for key in ("places", "place") if key in keys), "position")


class MapStep(StartStep):
    """A motion of a base in the map frame: a send_cmd with numbers."""

    @property
    @override
    def method(self) -> str:
        return "send_cmd"

    @override
    def may_repeat(self, functions: Mapping[str, StepFunction], info: ResourceInfo | None, command: str | None) -> bool:
        return True  # its goal is a place

    @override
    def call_words(self, resource: str, fields: Mapping[str, Any]) -> str:
        return " ".join([self.kind, resource, *(f"{number:.3f}" for number in fields.get("data", ()))])


class GoToStep(MapStep, kind="go_to"):
    """Drive to a place in the map frame; the step is over at rest there."""

    go_to: Annotated[
        Annotated[PositionArguments, Tag("position")]
        | Annotated[PlaceArguments, Tag("place")]
        | Annotated[PlacesArguments, Tag("places")],
        Discriminator(_form),
    ]

    @override
    def resolved_fields(self, names: Namespace) -> dict[str, Any]:
        found = super().resolved_fields(names)
        if isinstance(self.go_to, PlaceArguments):
            return {"place": place_of(found["place"])}
        if isinstance(self.go_to, PlacesArguments):
            places, index = places_of(found["places"]), int(names.variables["index"])  # type: ignore[call-overload]
            if index >= len(places):
                raise ScenarioError(f"there are {len(places)} places, but this is robot {index + 1} of the role")
            return {"place": places[index]}
        goal = [number_of(found["x_m"], "x_m"), number_of(found["y_m"], "y_m")]
        if found["yaw_deg"] is not None:
            goal.append(heading_rad(number_of(found["yaw_deg"], "yaw_deg")))
        return {"cmd": "goto", "data": goal}

    @override
    def call_words(self, resource: str, fields: Mapping[str, Any]) -> str:
        if isinstance(self.go_to, PositionArguments):
            return super().call_words(resource, fields)
        return f"{self.kind} {place_words(fields['place'])}" if "place" in fields else self.kind

    @override
    def check_placement(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        super().check_placement(check, path, scope)
        if self.together and not isinstance(self.go_to, PositionArguments):
            check.report((*path, "together"), "is for x_m and y_m: trips to places begin as their plan says", key=True)

    @override
    def check_robots(self, check: RobotCheck, path: YamlPath, here: RobotScope) -> None:
        if isinstance(self.go_to, PositionArguments):
            super().check_robots(check, path, here)
            return
        self.check_numbers(check, path, here)
        check_driving(check, (*path, self.kind), here)
        if isinstance(self.go_to, PlaceArguments):
            where = (*path, self.kind, "place")
            takes_turns = any(step.kind == "wait_for" for _, step in here.scenario.file.walk())  # to leave it
            is_shared = len(check.regular(here)) > 1 and not (here.values.around or takes_turns)
            for _, _, (place,) in known_places(check, (self.go_to.place,), where, here):
                if is_shared and not here.values.needs_facts(expressions_in(self.fields()["place"])):
                    message = f"several robots would go to one place, {place_words(place)}; give each its own: `places`"
                    check.report(here, where, message)
            return
        where = (*path, self.kind, "places")
        count = len(check.regular(here))
        for _, _, places in known_places(check, self.go_to.places, where, here):
            if len(places) < count:
                check.report(here, where, f"{len(places)} places are too few for the {count} robots of the role")
            for place in dict.fromkeys(place for place in places if places.count(place) > 1):
                check.report(here, where, f"two robots would go to one place, {place_words(place)}")

    @override
    def begin(
        self, run: RunContext, robot: Participant, resource: str, fields: Mapping[str, Any], timeout_s: float | None
    ) -> Future[Any]:
        if isinstance(self.go_to, PositionArguments):
            return super().begin(run, robot, resource, fields, timeout_s)
        return begin_trip(run, robot.handle, fields["place"], timeout_s)
