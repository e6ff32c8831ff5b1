"""Reading scenario files, and the scenarios that their steps run, with all of their problems."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from eal_actors.kernel.bundled import find_file, require_kind, short_path
from eal_actors.kernel.errors import ArgumentError, ConfigError, Problem, file_error
from eal_actors.kernel.strict_model import model_of, schema_of
from eal_actors.kernel.yaml_source import LARGE, parse_yaml, read_file
from eal_actors.kernel.yaml_tree import format_path
from eal_actors.scenario.language.parameters import check_parameters, set_parameters
from eal_actors.scenario.language.repair import RepairedFile, repair
from eal_actors.scenario.language.scenario import Scenario, ScenarioFile, use_step_kinds
from eal_actors.scenario.language.scope import check_scope
from eal_actors.scenario.steps.registry import step_union

use_step_kinds(step_union)

MAX_PARTS_DEEP: Final = 8
"""Maximum nesting of scenarios."""
_STEPS: Final = re.compile(r"""^(["']?)steps\1\s*:""", re.MULTILINE)
MAX_STEPS: Final = 100_000
"""Maximum steps of a scenario; those of a part count each time it is used."""


def load_scenario(path: str | Path, parameters: Mapping[str, object] | None = None) -> Scenario:
    """Read a scenario file. Environment variables have no effect on it.

    Args:
        path: the scenario file, or the name of a bundled one, such as `dance`.
        parameters: values of its parameters by name, in place of their defaults. Those without a default may be given
            later, to `make_plan`.

    Raises:
        ConfigError: with every problem of the file, and of the scenarios that its steps run.
    """
    file = find_file(path, "scenario")
    return _Loader().load(file, parameters or {})


def parse_scenario(
    text: str, name: str, parameters: Mapping[str, object] | None = None, folder: Path | None = None
) -> Scenario:
    """Read a scenario from its text.

    Args:
        text: the content of a scenario file.
        name: the file's name in problems.
        parameters: as for `load_scenario`.
        folder: the folder of scenarios that its steps run; defaults to the working directory.

    Raises:
        ConfigError: as for `load_scenario`.
    """
    return _Loader().parse(text, name, (folder or Path()) / name, parameters or {})


def examine_scenario(path: str | Path) -> tuple[Scenario | None, Callable[[Problem], bool]]:
    """Read a scenario file that may have problems, so that a fleet can be checked against the rest of it.

    Return it without what is wrong in it, None if nothing is left; and whether a problem is none of its own.
    """
    file, loader = find_file(path, "scenario"), _Loader()
    try:
        return loader.load(file, {}), lambda _: True
    except ConfigError:
        return loader.salvaged


def is_scenario_file(path: Path) -> bool:
    """Return whether a YAML file has steps, as a scenario has, and a fleet or a world has not."""
    return bool(_STEPS.search(path.read_text(encoding="utf-8", errors="replace")))


def find_fleet_beside(path: Path) -> Path:
    """Return `<scenario>.fleet.yaml` or `fleet.yaml` in the folder of a scenario; raise ArgumentError without both."""
    beside = [path.with_name(f"{path.stem}.fleet.yaml"), path.with_name("fleet.yaml")]
    found = next((file for file in beside if file.is_file()), None)
    if found is None:
        names = " nor ".join(file.name for file in beside)
        raise ArgumentError(f"no fleet for {short_path(path)}: give --eal-fleet FILE; there is neither {names}")
    return found


def check_scenario(path: str | Path) -> tuple[Problem, ...]:
    """Return every problem of a scenario file that can be found without a fleet."""
    try:
        load_scenario(path)
    except ConfigError as error:
        return error.problems
    return ()


def scenario_schema() -> dict[str, Any]:
    """Return the JSON Schema of scenario files, for completion and checks in editors."""
    return schema_of(ScenarioFile)


class _Loader:
    """Reads one scenario and those inside it, each file once.

    `salvaged` is the rest of the last file with problems, and whether a problem is not due to what was removed.
    """

    def __init__(self) -> None:
        self._done: dict[Path, Scenario | ConfigError] = {}
        self._open: list[Path] = []
        self.salvaged: tuple[Scenario | None, Callable[[Problem], bool]] = (None, lambda _: False)

    def load(self, path: Path, parameters: Mapping[str, object]) -> Scenario:
        """Read a file."""
        return self.parse(read_file(path, LARGE), str(path), path, parameters)

    def parse(self, text: str | bytes, name: str, path: Path, parameters: Mapping[str, object]) -> Scenario:
        """Read a text as the content of a file; problems call it `name`."""
        tree = parse_yaml(text, name, limits=LARGE)
        require_kind(tree, "scenario")
        lines = (text if isinstance(text, str) else text.decode("utf-8").removeprefix("\ufeff")).split("\n")
        wrong: list[Problem] = []
        repaired: RepairedFile | None = None
        try:
            file = model_of(ScenarioFile, tree)
        except ConfigError as error:
            wrong = list(error.problems)
            repaired = repair(tree, wrong)
            if repaired is None:
                raise
            file = repaired.file
        scenario = Scenario(Path(name), file, tree, tuple(lines))
        self._open.append(path.resolve())
        try:
            parts, size, problems = self._parts(scenario, path)
        finally:
            self._open.pop()
        scenario = replace(scenario, parts=parts, size=size).with_named_robots()
        problems += check_parameters(file, tree)
        problems += check_scope(scenario, repaired.names if repaired is not None else ())
        if repaired is not None:
            problems = wrong + [problem for problem in problems if not repaired.concerns(problem)]
        if problems:
            known = {(problem.line, problem.column) for problem in problems}

            def is_other(problem: Problem) -> bool:
                is_due_to_repair = repaired is not None and repaired.concerns(problem)
                return not is_due_to_repair and (problem.line, problem.column) not in known

            self.salvaged = set_parameters(scenario, {}), is_other
            raise ConfigError(list(dict.fromkeys(problems)))
        return set_parameters(scenario, parameters)

    def _parts(self, scenario: Scenario, path: Path) -> tuple[dict[str, Scenario], int, list[Problem]]:
        """Return the parts of a scenario, its number of steps with theirs, and the problems of the parts."""
        parts: dict[str, Scenario] = {}
        problems: list[Problem] = []
        steps = list(scenario.file.walk())
        size = len(steps)
        for here, step in steps:
            if step.part_file is None:
                continue
            try:
                part = parts[format_path(here)] = self._part(find_file(step.part_file, "scenario", path.parent))
            except ConfigError as error:
                for problem in error.problems:
                    message = f"{problem.file}: {problem.message}"
                    problems.append(problem if problem.line else scenario.problem((*here, step.kind), message))
                continue
            size += part.size
            if size > MAX_STEPS:
                message = f"makes more than {MAX_STEPS} steps, each use of a scenario counted"
                problems.append(scenario.problem((*here, step.kind), message))
                break
        return parts, size, problems

    def _part(self, path: Path) -> Scenario:
        real = path.resolve()
        if real in self._open:
            circle = " -> ".join(open_path.name for open_path in [*self._open[self._open.index(real) :], real])
            raise file_error(path, f"includes itself: {circle}")
        if len(self._open) >= MAX_PARTS_DEEP:
            raise file_error(path, f"is the {MAX_PARTS_DEEP + 1}th scenario inside another")
        if real not in self._done:
            try:
                self._done[real] = self.load(path, {})
            except ConfigError as error:
                self._done[real] = error
        found = self._done[real]
        if isinstance(found, ConfigError):
            raise found
        return found
