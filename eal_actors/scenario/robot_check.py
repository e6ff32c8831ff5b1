"""What can be wrong with a scenario on the robots that will carry it out, found before anything moves."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from eal_actors.data import EALData
from eal_actors.errors import ArgumentError, EALError, Problem
from eal_actors.info import METHODS, ResourceInfo, ValueInfo, unknown_name
from eal_actors.scenario.calls import AnswerStep, CallStep, call_fields, resolved_fields
from eal_actors.scenario.files import answer_problem, check_file_name
from eal_actors.scenario.model import ForStep, OnStep, RepeatStep, Step
from eal_actors.scenario.scenario import Scenario
from eal_actors.scenario.variables import names_in, substitute_text
from eal_actors.yaml_tree import YamlPath

MAX_COMBINATIONS: Final = 100_000
"""How many values of the loops around a step are tried; a step that needs more is a problem."""
_MOST_NAMED: Final = 3

Loops = Mapping[str, Sequence[object]]


@dataclass(frozen=True, slots=True)
class RobotFacts:
    """What a check must know of a robot.

    Attributes:
        resources: what its resources say of themselves, by name.
        left_out: why it may have fewer than one would think; empty for no reason.
    """

    resources: Mapping[str, ResourceInfo]
    left_out: str = ""


def check_on_robots(
    scenario: Scenario, roles: Mapping[str, Sequence[str]], robots: Mapping[str, RobotFacts]
) -> list[Problem]:
    """Return what the robots cannot do: every call, with every value of every loop around it.

    Only what depends on a value that is saved during the run stays unchecked.

    Args:
        scenario: a scenario without problems of its own.
        roles: the robots of each role.
        robots: what they can do; a robot that is missing here is passed over.
    """
    checker = _Checker(scenario, roles, robots)
    checker.visit_all(scenario.file.steps, ("steps",), (), {})
    checker.visit_all(scenario.file.finally_, ("finally",), (), {})
    return checker.problems()


class _Checker:
    def __init__(
        self, scenario: Scenario, roles: Mapping[str, Sequence[str]], robots: Mapping[str, RobotFacts]
    ) -> None:
        self._scenario = scenario
        self._roles = roles
        self._robots = robots
        self._found: dict[tuple[YamlPath, str], dict[str, None]] = {}

    def problems(self) -> list[Problem]:
        """Return one problem for each place and message, naming the robots."""
        return [
            self._scenario.tree.problem(path, f"{_shown(robots)}: {message}" if robots else message)
            for (path, message), robots in self._found.items()
        ]

    def visit_all(self, steps: Sequence[Step], path: YamlPath, robots: Sequence[str], loops: Loops) -> None:
        """Check steps for these robots, within these loops."""
        for index, step in enumerate(steps):
            here = (*path, index)
            if isinstance(step, CallStep):
                self._call(step, here, robots, loops)
            elif isinstance(step, OnStep):
                bound = [robot for robot in self._roles[step.on] if robot in self._robots]
                self.visit_all(step.do, (*here, "do"), bound, loops)
            elif isinstance(step, ForStep | RepeatStep):
                name, values = step.loop
                self.visit_all(step.do, (*here, "do"), robots, {**loops, name: values})

    def _report(self, path: YamlPath, message: str, robots: Sequence[str]) -> None:
        self._found.setdefault((path, message), {}).update(dict.fromkeys(robots))

    def _call(self, step: CallStep, path: YamlPath, robots: Sequence[str], loops: Loops) -> None:
        fields = {"resource": step.arguments.resource, **call_fields(step)}
        used = names_in(tuple(fields.values()))
        within = {name: loops[name] for name in used if name in loops}
        if (count := math.prod(len(values) for values in within.values())) > MAX_COMBINATIONS:
            message = f"the loops around this step give {count} combinations; at most {MAX_COMBINATIONS} can be checked"
            self._report(path, message, ())
            return
        for variables in _combinations(within):
            resource = substitute_text(step.arguments.resource, variables)
            for info, having in self._by_info(resource, (*path, step.method, "resource"), robots).items():
                self._arguments(step, path, info, having, variables)
        if isinstance(step, AnswerStep) and step.save is not None:
            self._file_names(step.save, (*path, "save"), loops)

    def _by_info(self, resource: str, path: YamlPath, robots: Sequence[str]) -> dict[ResourceInfo, list[str]]:
        """Return the robots that have the resource, those with the same kind of it together."""
        having: dict[ResourceInfo, list[str]] = {}
        for robot in robots:
            facts = self._robots[robot]
            info = facts.resources.get(resource)
            if info is None:
                self._report(path, unknown_name("resource", resource, facts.resources) + facts.left_out, [robot])
            else:
                having.setdefault(info, []).append(robot)
        return having

    def _arguments(
        self, step: CallStep, path: YamlPath, info: ResourceInfo, robots: list[str], variables: Mapping[str, object]
    ) -> None:
        if step.method != "halt" and step.method not in info.methods:
            supported = ", ".join(method for method in METHODS if method in info.methods) or "nothing"
            message = f"{info.name} does not support {step.method}; it supports {supported}"
            self._report((*path, step.method), message, robots)
            return
        if any(name not in variables for name in names_in(tuple(call_fields(step).values()))):
            return  # it depends on a value that is saved during the run
        given: dict[str, Any] = {}
        try:
            given = {name: value for name, value in resolved_fields(step, variables).items() if value is not None}
            _check_arguments(step.method, info, given)
        except EALError as error:
            at = next(iter(call_fields(step)), "resource")
            self._report((*path, step.method, at), error.message, robots)
            return
        if isinstance(step, AnswerStep) and step.save is not None:
            answer = _answer_info(step.method, info, given)
            if answer is not None and (problem := answer_problem(step.save, answer)) is not None:
                self._report((*path, "save"), problem, robots)

    def _file_names(self, template: str, path: YamlPath, loops: Loops) -> None:
        within = {name: loops[name] for name in names_in(template) if name in loops}
        if len(within) < len(names_in(template)):
            return
        for variables in itertools.islice(_combinations(within), MAX_COMBINATIONS):
            try:
                check_file_name(substitute_text(template, variables))
            except EALError as error:
                self._report(path, error.message, ())


def _combinations(loops: Loops) -> Iterator[dict[str, object]]:
    for values in itertools.product(*loops.values()):
        yield dict(zip(loops, values, strict=True))


def _shown(robots: Mapping[str, None]) -> str:
    names = list(robots)
    more = len(names) - _MOST_NAMED
    return ", ".join(names) if more <= 0 else f"{', '.join(names[:_MOST_NAMED])} and {more} more"


def _check_arguments(method: str, info: ResourceInfo, given: Mapping[str, Any]) -> None:
    """Check what a method is given, as far as the resource says what it takes.

    Raises:
        ArgumentError: an unknown command, request or key, or an argument that does not fit.
        DataError: a value that no EALData can hold.
    """
    if method == "send_cmd" and info.commands:
        info.parse_command(str(given["cmd"]), EALData.of(given["data"]) if "data" in given else None)
    elif method == "send_req" and info.requests:
        info.parse_request(str(given["req"]))
    elif method == "get_config" and info.configs:
        info.config(str(given["key"]))
    elif method == "set_config" and info.configs:
        _check_config(info, str(given["key"]), EALData.of(given["value"]) if "value" in given else None)
    elif method == "set_value":
        data = EALData.of(given["value"])
        if info.value is not None:
            info.value.check(data, "its value")
    elif method == "write_comm":
        EALData.of(given["data"])


def _answer_info(method: str, info: ResourceInfo, given: Mapping[str, Any]) -> ValueInfo | None:
    """Return what a resource says of its answer to a call that it takes, or None if it says nothing."""
    if method == "get_value":
        return info.value
    if method == "send_req" and info.requests:
        return info.parse_request(str(given["req"]))[0].returns
    if method == "get_config" and info.configs:
        return info.config(str(given["key"])).value
    return None


def _check_config(info: ResourceInfo, key: str, data: EALData | None) -> None:
    config = info.config(key)
    if not config.writable:
        raise ArgumentError(f"configuration key {key!r} is read-only")
    if data is None:
        raise ArgumentError(f"configuration key {key!r} needs a value: {config.value.describe()}")
    config.value.check(data, f"configuration key {key!r}")
