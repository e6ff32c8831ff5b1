"""Branches of a run: the same past, to the bit, and then another future."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

import yaml

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ScenarioError
from eal_actors.lab.branching.past import RecordedInput
from eal_actors.lab.proof.fleet_files import FAULTS, Content, fleet_content, injectable_faults, load_content, with_plan
from eal_actors.lab.proof.trial import ends_before
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.recording import (
    Difference,
    RepeatedPast,
    RunFolder,
    RunRecorder,
    first_difference,
    folder_errors,
    keep_provenance,
    new_run_folder,
)
from eal_actors.recording.provenance import WORLD
from eal_actors.scenario import Report, Run, Scenario, load_scenario, make_plan
from eal_actors.scenario.language.parameters import with_parameters

BRANCH: Final = "branch.json"
_SAMPLED_S: Final = 1.0
"""The end of the past that is sampled and compared with the run; poses before it are copied. Sampling four robots took
20 of 27 s of a branch after 8 minutes."""


@dataclass(frozen=True, slots=True)
class BranchRequest:
    """Another future of a run.

    Attributes:
        past: the input of the run.
        at_s: when the futures part, in seconds since the run's start.
        without: faults that are absent from then on: `fault` or `robot.fault`, by their names in the fleet file.
        added: faults that begin then: `robot.fault` and their values.
        parameters: values of parameters for the steps that begin from then on.
        scenario: the file of another version of the scenario, whose past must be the same.
    """

    past: RecordedInput
    at_s: float
    without: Sequence[str] = ()
    added: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, object] = field(default_factory=dict)
    scenario: Path | None = None

    def require_time(self) -> None:
        """Raise ScenarioError if the run has no state at the time."""
        duration_s = self.past.report.duration_s
        if not 0 <= self.at_s <= duration_s:
            raise ScenarioError(f"the run lasted {duration_s:.2f} s; it has no state at {self.at_s:g} s")

    def require_planned(self) -> None:
        """Raise ScenarioError if the run has not one of the faults that are to be absent."""
        planned = list(_planned(fleet_content(self.past.config, None)))
        for name in self.without:
            robot, _, fault = name.rpartition(".")
            if not any(fault in entry and robot in ("", owner) for owner, _, entry in planned):
                known = ", ".join(
                    dict.fromkeys(f"{owner}.{key}" for owner, _, entry in planned for key in _keys(entry))
                )
                raise ScenarioError(f"the run has no fault {name!r}; its faults are: {known or 'none'}")

    def require_injectable(self) -> None:
        """Raise ScenarioError if a fault is to begin in a robot that takes none."""
        injectable = injectable_faults(self.past.config)
        for name in self.added:
            if name.rpartition(".")[0] not in injectable:
                raise ScenarioError(f"{name!r}: faults can be injected into {', '.join(injectable) or 'no robot'}")


@dataclass(frozen=True, slots=True)
class Branch:
    """A branch that has ended; `first` is the first difference from the run, None if they are the same to the end."""

    directory: Path
    report: Report
    first: Difference | None


def branch(request: BranchRequest, runs_dir: Path) -> Branch:
    """Repeat a run up to a time, and continue it differently, in a folder below `runs_dir`.

    Raises:
        ConfigError: a file is invalid, or a parameter has no such value.
        ScenarioError: the run has no such state or fault, or the past differs.

    Thread: blocks the caller.
    """
    request.require_time()
    request.require_planned()
    request.require_injectable()
    past = request.past
    scenario = past.scenario
    if request.scenario is not None:
        scenario = load_scenario(request.scenario)
        given = past.report.parameters.items()
        scenario = with_parameters(scenario, {key: value for key, value in given if key in scenario.file.parameters})
    changed = with_parameters(scenario, request.parameters).parameters  # checks them
    world = (past.folder.path / WORLD).resolve()
    content: Content = fleet_content(past.config, world if world.is_file() else None)
    start_s = _start_s(scenario, past)
    content = _without_faults(content, request.without, start_s + request.at_s)
    content = _with_faults(content, past.config, request.added, start_s + request.at_s)
    values = {name: changed[name] for name in request.parameters}
    config = load_content(content, past.config.source)
    copied = RepeatedPast(past.folder, round(request.at_s - _SAMPLED_S, 3), start_s, request.at_s)
    for repeated in (copied, None) if copied.until_s > 0 else (None,):
        make_folder = partial(_make_folder, request, runs_dir, f"{scenario.name}-branch")
        directory, report = _perform(scenario, config, past, make_folder, (request.at_s, values), repeated)
        made = RunFolder.open(directory)
        before = first_difference(past.folder, made, request.at_s)
        if before is None:
            return Branch(directory, report, first_difference(past.folder, made))
        if repeated is None:
            raise ScenarioError(
                f"the past of the branch in {directory} differs: {before.where}: {before.left}, now {before.right}; "
                "branch before that, or look for what does not repeat"
            )
        shutil.rmtree(directory)  # samples change this past, such as by noise that every reading draws
    raise AssertionError("the last try returns or raises")


def _make_folder(request: BranchRequest, runs_dir: Path, name: str) -> Path:
    directory = new_run_folder(runs_dir, name)
    facts = {"run": str(request.past.folder.path), "at_s": request.at_s, "without": list(request.without)}
    facts |= {"added": dict(request.added), "parameters": dict(request.parameters)}
    with folder_errors(directory):
        (directory / BRANCH).write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")
    return directory


def _perform(
    scenario: Scenario,
    config: FleetConfig,
    past: RecordedInput,
    make_folder: Callable[[], Path],
    change: tuple[float, Mapping[str, object]],
    repeated: RepeatedPast | None,
) -> tuple[Path, Report]:
    """Run and record the branch, in a folder that is made when nothing is wrong; change its parameters in time."""
    at_s, values = change
    with Fleet(config).connect(past.robots) as fleet:
        for problem in fleet.problems:
            raise problem
        plan = make_plan(scenario, fleet, binding=past.binding)
        directory = make_folder()
        with folder_errors(directory):
            keep_provenance(directory, config, scenario)
            recorded = [name for name in plan.robots if name not in plan.lost]
            recorder = RunRecorder(fleet, recorded, directory, past=repeated)
        run = Run(plan, fleet, directory, [recorder.hear])
        with recorder:
            future = run.start()
            if values and not ends_before(future, fleet.clock, at_s):
                run.set_parameters(values)
            ends_before(future, fleet.clock, None)
        return directory, future.get()


def _start_s(scenario: Scenario, past: RecordedInput) -> float:
    """Return the start of the run by the fleet's clock: the time that connecting and planning take."""
    with Fleet(past.config).connect(past.robots) as fleet:
        make_plan(scenario, fleet, binding=past.binding)
        return fleet.clock.now()


def _without_faults(content: Content, names: Sequence[str], at_s: float) -> Content:
    """Return a fleet in which planned faults are absent from a time of the fleet's clock."""
    for name in names:
        robot, _, fault = name.rpartition(".")
        content = _ended(content, robot, fault, at_s)
    return content


def _ended(content: Content, robot: str, fault: str, at_s: float) -> Content:
    robots = dict(content["robots"])
    for owner, instance, entry in _planned(content):
        if fault not in entry or robot not in ("", owner):
            continue
        settings = robots[owner]["plugins"][instance]
        kept: list[dict[str, Any]] = []
        for one in settings[FAULTS]:
            kept += _split(one, fault, at_s) if one == entry else [one]
        robots[owner] = with_plan(robots[owner], instance, kept)
    return {**content, "robots": robots}


def _split(entry: Mapping[str, Any], fault: str, at_s: float) -> Iterator[dict[str, Any]]:
    """Yield a planned fault without one of its keys, and that key up to a time."""
    rest = {key: value for key, value in entry.items() if key != fault}
    if any(_keys(rest)):
        yield rest
    if entry["at_s"] < at_s:
        until_s = min(entry.get("until_s", at_s), at_s)
        yield {"at_s": entry["at_s"], "until_s": until_s, fault: entry[fault]}


def _with_faults(content: Content, config: FleetConfig, added: Mapping[str, Any], at_s: float) -> Content:
    robots, injectable = dict(content["robots"]), injectable_faults(config)
    for name, value in added.items():
        robot, _, fault = name.rpartition(".")
        instance = injectable[robot][0]
        plan = [*robots[robot]["plugins"][instance].get(FAULTS, ()), {"at_s": at_s, fault: value}]
        robots[robot] = with_plan(robots[robot], instance, plan)
    return {**content, "robots": robots}


def _planned(content: Content) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    """Yield the robot, the plugin instance and the entry of each planned fault."""
    for robot, section in content["robots"].items():
        for instance, settings in section["plugins"].items():
            for entry in settings.get(FAULTS, ()):
                yield robot, instance, entry


def _keys(entry: Mapping[str, Any]) -> Iterator[str]:
    return (key for key in entry if key not in ("at_s", "until_s"))


def parse_fault(text: str) -> tuple[str, Any]:
    """Parse `robot.fault` or `robot.fault=value`, by default true; raise ValueError if the text has another form."""
    name, equals, value = text.partition("=")
    if not name.rpartition(".")[0]:
        raise ValueError(f"must be ROBOT.FAULT or ROBOT.FAULT=VALUE, not {text!r}")
    try:
        return name, yaml.safe_load(value) if equals else True
    except yaml.YAMLError as error:
        raise ValueError(f"{name} has no value: {value!r} is no YAML: {getattr(error, 'problem', error)}") from error
