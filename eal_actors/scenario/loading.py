"""Reads scenario files, and the scenarios that they carry out, and finds everything that is wrong with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from eal_actors.kernel.bundled import find_file
from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.strict_model import problems_from
from eal_actors.kernel.yaml_source import LARGE, parse_yaml, read_file
from eal_actors.kernel.yaml_tree import YamlPath, format_path
from eal_actors.scenario.checks import check_scope
from eal_actors.scenario.model import AnyStep, ScenarioFile, ScenarioStep, inner_steps
from eal_actors.scenario.parameters import check_parameters, resolve_parameters
from eal_actors.scenario.scenario import Scenario

MAX_PARTS_DEEP: Final = 8
"""How many scenarios may stand inside each other."""
MAX_STEPS: Final = 100_000
"""How many steps a scenario may have, with those of its parts as often as they are carried out."""


def load_scenario(path: str | Path, parameters: Mapping[str, object] | None = None) -> Scenario:
    """Read a scenario file. The environment has no say in it.

    Args:
        path: the scenario file, or the name of one that comes with the framework, such as `dance`.
        parameters: values of its parameters by name, in place of their defaults. Those without a default may be given
            later, to `make_plan`.

    Raises:
        ConfigError: with every problem of the file, and of the scenarios that it carries out.
    """
    file = find_file(path, "scenario")
    return _Loader().load(file, str(file), parameters or {})


def parse_scenario(
    text: str, name: str, parameters: Mapping[str, object] | None = None, folder: Path | None = None
) -> Scenario:
    """Read a scenario from its text.

    Args:
        text: the content of a scenario file.
        name: what to call it in problems.
        parameters: see load_scenario.
        folder: where scenarios that it carries out are looked for; the working directory if None.

    Raises:
        ConfigError: see load_scenario.
    """
    return _Loader().parse(text, name, (folder or Path()) / name, parameters or {})


def check_scenario(path: str | Path) -> tuple[Problem, ...]:
    """Return every problem of a scenario file, as far as it can be told without a fleet."""
    try:
        load_scenario(path)
    except ConfigError as error:
        return error.problems
    return ()


def scenario_schema() -> dict[str, Any]:
    """Return the JSON Schema of scenario files, for editors that complete and check while one types."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **ScenarioFile.model_json_schema()}


def with_parameters(scenario: Scenario, given: Mapping[str, object]) -> Scenario:
    """Return a scenario with other values of its parameters.

    Raises:
        ConfigError: a parameter that it does not have, or a value that it may not have.
    """
    if not given:
        return scenario
    return _given(scenario, {**scenario.parameters, **given})


def _given(scenario: Scenario, given: Mapping[str, object]) -> Scenario:
    def place(_: str, message: str) -> Problem:
        return scenario.problem(("parameters",) if scenario.file.parameters else (), message, key=True)

    values, problems = resolve_parameters(scenario.file, given, place, scenario.tree)
    if problems:
        raise ConfigError(problems)
    return replace(scenario, parameters=values)


class _Loader:
    """Reads one scenario and those inside it, each file once."""

    def __init__(self) -> None:
        self._done: dict[Path, Scenario | ConfigError] = {}
        self._open: list[Path] = []

    def load(self, path: Path, name: str, parameters: Mapping[str, object]) -> Scenario:
        """Read a file; it is named in problems as `name`."""
        return self.parse(read_file(name, LARGE), name, path, parameters)

    def parse(self, text: str | bytes, name: str, path: Path, parameters: Mapping[str, object]) -> Scenario:
        """Read a text as the content of a file."""
        tree = parse_yaml(text, name, limits=LARGE)
        lines = (text if isinstance(text, str) else text.decode("utf-8").removeprefix("\ufeff")).split("\n")
        try:
            file = ScenarioFile.model_validate(tree.root)
        except ValidationError as error:
            raise ConfigError(problems_from(error, tree, ScenarioFile)) from None
        scenario = Scenario(path if str(path) == name else Path(name), file, tree, tuple(lines))
        self._open.append(path.resolve())
        try:
            parts, size, problems = self._parts(scenario, path)
        finally:
            self._open.pop()
        scenario = replace(scenario, parts=parts, size=size)
        problems += check_parameters(file, tree)
        problems += check_scope(scenario)
        if problems:
            raise ConfigError(list(dict.fromkeys(problems)))
        return _given(scenario, parameters)

    def _parts(self, scenario: Scenario, path: Path) -> tuple[dict[str, Scenario], int, list[Problem]]:
        """Return the parts of a scenario, how many steps it has with theirs, and what is wrong with them."""
        parts: dict[str, Scenario] = {}
        problems: list[Problem] = []
        steps = _walk(scenario.file)
        size = len(steps)
        for here, step in steps:
            if not isinstance(step, ScenarioStep):
                continue
            try:
                part = parts[format_path(here)] = self._part(path.parent / step.scenario)
            except ConfigError as error:
                for problem in error.problems:
                    outside = problem if problem.line else scenario.problem((*here, "scenario"), _told(problem))
                    problems.append(outside)
                continue
            size += part.size
            if size > MAX_STEPS:
                message = f"makes more than {MAX_STEPS} steps, each use of a scenario counted"
                problems.append(scenario.problem((*here, "scenario"), message))
                break
        return parts, size, problems

    def _part(self, path: Path) -> Scenario:
        real = path.resolve()
        if real in self._open:
            round_trip = " -> ".join(open_path.name for open_path in [*self._open[self._open.index(real) :], real])
            raise ConfigError([Problem(str(path), 0, 0, "", f"goes round in a circle: {round_trip}")])
        if len(self._open) >= MAX_PARTS_DEEP:
            raise ConfigError([Problem(str(path), 0, 0, "", f"is the {MAX_PARTS_DEEP + 1}th scenario inside another")])
        if real not in self._done:
            try:
                self._done[real] = self.load(path, str(path), {})
            except ConfigError as error:
                self._done[real] = error
        found = self._done[real]
        if isinstance(found, ConfigError):
            raise found
        return found


def _told(problem: Problem) -> str:
    return f"{problem.file}: {problem.message}"


def _walk(file: ScenarioFile) -> list[tuple[YamlPath, AnyStep]]:
    """Return all steps of a file with their paths."""
    found: list[tuple[YamlPath, AnyStep]] = []
    waiting: list[tuple[YamlPath, tuple[AnyStep, ...]]] = [(("finally",), file.finally_), (("steps",), file.steps)]
    while waiting:
        path, steps = waiting.pop()
        for index, step in enumerate(steps):
            found.append(((*path, index), step))
            waiting += [((*path, index, *keys), inner) for keys, inner in inner_steps(step)]
    return found
