"""The checks of a scenario against the robots that will run it, before anything moves.

Every call is tried with every value of every loop around it, as far as the values are known before the run. Robots with
the same resources are checked once, together. The number of tries is limited, so that a file cannot occupy the checker
for hours.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, NamedTuple

from eal_actors.device.data import EALData
from eal_actors.device.info import METHODS, ResourceInfo, unknown_name
from eal_actors.device.motion.map_motions import GOAL, MapMotions
from eal_actors.device.world import WorldModel
from eal_actors.kernel.errors import EALError, PlaceNotFoundError, Problem
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.language.binding import Binding, RobotFacts
from eal_actors.scenario.language.expressions.evaluation import (
    MAX_WORK,
    LocatedExpression,
    Namespace,
    WorkBudget,
    evaluate,
    expressions_in,
    locate_expressions,
    render,
    text_of,
)
from eal_actors.scenario.language.expressions.grammar import Expression
from eal_actors.scenario.language.scenario import RobotsByRole, Scenario, Step
from eal_actors.scenario.language.static_values import MAX_COMBINATIONS, StaticValues, TooManyCombinationsError
from eal_actors.scenario.language.values import Wanted, number_problem

MAX_IN_ALL: Final = 200_000
"""Maximum combinations that are tried for all steps of a scenario together."""
_MOST_NAMED: Final = 3


class Location(NamedTuple):
    """The location of a problem: a value, and the offset in its text."""

    path: YamlPath
    inside: tuple[str, int] | None = None


class CheckedCall(NamedTuple):
    """A call to check, with the locations of its parts. The arguments are None if they are not known."""

    method: str
    resource: str
    given: Mapping[str, Any] | None
    resource_at: Location
    method_at: Location
    arguments_at: Location

    @classmethod
    def at(cls, location: Location, method: str, resource: str, given: Mapping[str, Any]) -> CheckedCall:
        """Return a call whose parts have one location."""
        return cls(method, resource, given, location, location, location)


@dataclass(frozen=True, slots=True)
class RobotScope:
    """The surroundings of a step, with the robots that come to it, spares included.

    `groups` are the robots of the `on` around it; those with the same resources are in one group. If it `is_of_one`,
    each robot runs the scenario by itself.
    """

    scenario: Scenario
    roles: RobotsByRole
    values: StaticValues
    groups: tuple[tuple[str, ...], ...] = ()
    role: str = ""
    is_of_one: bool = False

    def are_known(self, expressions: Iterable[Expression]) -> bool:
        """Return whether the values of all expressions are known before the run."""
        return all(map(self.values.is_known, expressions))


class RobotCheck:
    """A walk through the steps with the robots that come to them; robots without facts are not checked.

    Args:
        robots: the facts about each robot, by name.
        bound: the robots of each role.
        world: of the fleet; its places are known by name.
        has_map: whether paths are planned on a map, so that points may be outside the world's room.
    """

    def __init__(
        self, robots: Mapping[str, RobotFacts], bound: Binding, world: WorldModel | None, *, has_map: bool = False
    ) -> None:
        self.budget = WorkBudget("the expressions of this scenario", MAX_WORK)
        self._robots = robots
        self._bound = bound
        self._world = world
        self._room = None if has_map else world
        self._spares = {spare for names in bound.spares.values() for spare in names}
        self._kinds = _number_kinds(robots)
        self._found: dict[tuple[int, YamlPath, str], tuple[Callable[[str], Problem], dict[str, None]]] = {}
        self._answers: dict[tuple[Any, ...], str | None] = {}
        self._spent = 0

    def problems_of(self, scenario: Scenario, seed: int = 0) -> list[Problem]:
        """Return what the robots cannot do: every call, with every value of every loop around it.

        Values that arise only during the run are not checked. Each location and message is one problem, with the names
        of the robots. The seed is the fleet's.
        """
        everyone = {role: (*names, *self._bound.spares.get(role, ())) for role, names in self._bound.roles.items()}
        with self.budget.applied():
            values = StaticValues({**scenario.parameters, "run": {"seed": seed}})
            self.visit_file(RobotScope(scenario, everyone, values))
        return [
            make(f"{_list_robots(robots)}: {message}" if robots else message)
            for (_, _, message), (make, robots) in self._found.items()
        ]

    def report(
        self,
        here: RobotScope,
        path: YamlPath,
        message: str,
        robots: Sequence[str] = (),
        inside: tuple[str, int] | None = None,
    ) -> None:
        """Add a problem of some robots, or of the scenario without robots."""
        make = partial(here.scenario.problem, path, inside=inside)
        self._found.setdefault((id(here.scenario), path, message), (make, {}))[1].update(dict.fromkeys(robots))

    def visit_file(self, here: RobotScope) -> None:
        """Check the steps of a scenario, `finally` included."""
        self.visit_all(here.scenario.file.steps, ("steps",), here)
        self.visit_all(here.scenario.file.finally_, ("finally",), here)

    def visit_all(self, steps: Sequence[Step], path: YamlPath, here: RobotScope) -> None:
        """Check steps that follow each other."""
        for index, step in enumerate(steps):
            if self.budget.is_spent():
                return
            step.check_robots(self, (*path, index), here)
            if self.budget.is_spent() and all(message != self.budget.message() for *_, message in self._found):
                self.report(here, (*path, index), self.budget.message())

    def enter(self, role: str, here: RobotScope) -> RobotScope:
        """Return the scope inside an `on` of a role."""
        groups: dict[int, list[str]] = {}
        for robot in here.roles.get(role, ()):
            if robot in self._robots:
                groups.setdefault(self._kinds[robot], []).append(robot)
        values = replace(here.values, has_facts=True)
        return replace(here, groups=tuple(map(tuple, groups.values())), values=values, role=role)

    def combinations(
        self, expressions: Sequence[Expression], path: YamlPath, here: RobotScope
    ) -> Iterator[tuple[tuple[str, ...], Namespace]]:
        """Yield the robots and values to try a step with; robots with the same resources are tried together."""
        try:
            for robots, values in self._per_robot(expressions, here):
                for count, names in enumerate(values.combinations(expressions)):
                    if self._spent > MAX_IN_ALL:
                        return
                    self._spent += count > 0
                    if self._spent > MAX_IN_ALL:
                        message = f"up to here, loops give more than {MAX_IN_ALL} combinations"
                        self.report(here, path, f"{message}; the rest was not checked")
                    yield robots, names
        except TooManyCombinationsError as error:
            message = f"the loops around this step give {error} combinations; at most {MAX_COMBINATIONS} can be checked"
            self.report(here, path, message)

    def _per_robot(
        self, expressions: Sequence[Expression], here: RobotScope
    ) -> list[tuple[tuple[str, ...], StaticValues]]:
        if not here.groups:
            return [] if here.role else [((), here.values)]
        if not here.values.needs_facts(expressions):
            return [(robots, here.values) for robots in here.groups]
        return [
            ((robot,), replace(here.values, facts={"robot": robot, "role": here.role, "index": index, "count": count}))
            for robots in here.groups
            for robot in robots
            for index, count in self._indices(robot, here)
        ]

    def _indices(self, robot: str, here: RobotScope) -> list[tuple[int, int]]:
        """Return the numbers that a robot may have in its role: a spare may replace any robot."""
        if here.is_of_one:
            return [(0, 1)]
        regular = self.regular(here)
        if robot in regular:
            return [(regular.index(robot), len(regular))]
        return [(index, len(regular)) for index in range(len(regular))]

    def regular(self, here: RobotScope) -> list[str]:
        """Return the robots of the role of the `on`, without spares."""
        return [name for name in here.roles.get(here.role, ()) if name not in self._spares]

    # What steps have in common.

    def require_place(self, place: str | Sequence[float]) -> tuple[float, float, float]:
        """Return x_m, y_m and yaw_deg of a place.

        Raises PlaceNotFoundError unless the fleet's world has one of this name, or has this point in its room.
        """
        if isinstance(place, str):
            if self._world is None:
                raise PlaceNotFoundError(f"no place {place!r}: the fleet has no world; give its file a `world`")
            named = self._world.place(place)
            return named.x_m, named.y_m, named.yaw_deg or 0.0
        x_m, y_m, yaw_deg = *place, *(0.0,) * (3 - len(place))
        if self._room is not None:
            length_m, width_m = self._room.size_m
            if abs(x_m) > length_m / 2 or abs(y_m) > width_m / 2:
                raise PlaceNotFoundError(f"({x_m:.2f}, {y_m:.2f}) is outside the room of {length_m:g} x {width_m:g} m")
        return x_m, y_m, yaw_deg

    def number(self, text: str, wanted: Wanted, path: YamlPath, here: RobotScope) -> None:
        """Check a number of a step that is an expression, as far as it is known."""
        expressions = expressions_in(text)
        if not here.are_known(expressions):
            return
        for robots, names in self.combinations(expressions, path, here):
            try:
                problem = number_problem(render(text, names), wanted)
            except EALError as error:
                problem = error.message
            if problem is not None:
                self.report(here, path, problem, robots if here.values.facts else ())

    def text(self, text: str, path: YamlPath, here: RobotScope) -> None:
        """Check that the values in a text have a form there, as far as they are known: a list has none."""
        for located in locate_expressions((), text):
            self.expression(located, path, here, in_text=True)

    def expression(
        self, located: LocatedExpression, path: YamlPath, here: RobotScope, *, in_text: bool = False
    ) -> None:
        """Check that an expression has a value, with a form in a text if it is in one, as far as it is known."""
        if not here.values.is_known(located.expression):
            return
        for robots, names in self.combinations([located.expression], (*path, *located.keys), here):
            try:
                value = evaluate(located.expression, names)
                if in_text:
                    text_of(located.expression, value)
            except EALError as error:
                inside = (located.text, located.offset)
                self.report(here, (*path, *located.keys), error.message, robots if here.values.facts else (), inside)

    def readings(self, located: LocatedExpression, path: YamlPath, here: RobotScope) -> None:
        """Check the calls that an expression makes."""
        for reading, offset in located.expression.readings:
            key = {"send_req": "req", "get_config": "key"}.get(reading.method)
            given = {key: reading.argument} if key is not None else {}
            at = Location((*path, *located.keys), (located.text, located.offset + offset))
            for robots in here.groups:
                self.call(CheckedCall.at(at, reading.method, reading.resource, given), robots, here)

    def call(self, call: CheckedCall, robots: Sequence[str], here: RobotScope) -> ResourceInfo | None:
        """Check a call of robots with the same resources; return the resource's description if the call is valid."""
        facts, method, resource = self._robots[robots[0]], call.method, call.resource
        info = facts.resources.get(resource)
        if info is None:
            for robot in robots:
                message = unknown_name("resource", resource, facts.resources) + self._robots[robot].left_out
                self.report(here, call.resource_at.path, message, [robot], call.resource_at.inside)
            return None
        if method != "halt" and method not in info.methods:
            supported = ", ".join(name for name in METHODS if name in info.methods) or "nothing"
            message = f"{info.name} does not support {method}; it supports {supported}"
            self.report(here, call.method_at.path, message, robots, call.method_at.inside)
            return None
        denied = {robot: why for robot in robots if (why := self._robots[robot].denied(resource, method)) is not None}
        for robot, why in denied.items():
            self.report(here, call.method_at.path, f"{resource} {why}", [robot], call.method_at.inside)
        if denied:
            return None
        if call.given is None:
            return info
        key = (method, id(info), repr(call.given))
        if key not in self._answers:
            self._answers[key] = _argument_problem(method, info, call.given)
        if (wrong := self._answers[key]) is not None:
            self.report(here, call.arguments_at.path, wrong, robots, call.arguments_at.inside)
            return None
        return info


def _number_kinds(robots: Mapping[str, RobotFacts]) -> dict[str, int]:
    """Return a number for each robot, the same for robots with the same resources."""
    kinds: list[Mapping[str, ResourceInfo]] = []
    found: dict[str, int] = {}
    for name, facts in robots.items():
        number = next((index for index, known in enumerate(kinds) if known == facts.resources), len(kinds))
        if number == len(kinds):
            kinds.append(facts.resources)
        found[name] = number
    return found


def _list_robots(robots: Iterable[str]) -> str:
    names = list(robots)
    more = len(names) - _MOST_NAMED
    return ", ".join(names) if more <= 0 else f"{', '.join(names[:_MOST_NAMED])} and {more} more"


def _argument_problem(method: str, info: ResourceInfo, given: Mapping[str, Any]) -> str | None:
    """Return why a resource refuses arguments, as far as its description says, or None."""
    try:
        if method == "send_cmd" and info.commands:
            _check_command(info, given)
        elif method == "send_req" and info.requests:
            info.parse_request(str(given["req"]))
        elif method == "get_config" and info.configs:
            info.config(str(given["key"]))
        elif method == "set_config" and info.configs:
            info.config(str(given["key"])).checked(EALData.of(given["value"]) if "value" in given else None)
        elif method == "set_value":
            data = EALData.of(given["value"])
            if info.value is not None:
                info.value.check(data, "its value")
        elif method == "write_comm":
            EALData.of(given["data"])
    except EALError as error:
        return error.message
    return None


def _check_command(info: ResourceInfo, given: Mapping[str, Any]) -> None:
    """Raise ArgumentError if a resource refuses a command; the description of `goto` does not tell its limits."""
    data = EALData.of(given["data"]) if "data" in given else None
    command, argument = info.parse_command(str(given["cmd"]), data)
    if command.argument == GOAL and argument is not None:
        MapMotions.goal_numbers(argument.value)
