"""What `eal run` is told on its command line: values, robots, rates, and runs to go on with."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import typer

from eal_actors.cli.opening import check_plugins, read_fleet
from eal_actors.kernel.errors import ConfigError, Problem, ScenarioError
from eal_actors.kernel.lock_step import MAX, Rate
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.scenario import Resumption, Scenario, load_scenario, read_run
from eal_actors.scenario.language.parameters import read_settings, with_parameters

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Order:
    """What is to be run, on what.

    Attributes:
        scenario: the scenario, with the values of its parameters.
        config: the fleet.
        binding: robots by role that were bound by hand; None for none.
        resumption: where a run that was cut off goes on.
    """

    scenario: Scenario
    config: FleetConfig
    binding: Mapping[str, Sequence[str]] | None = None
    resumption: Resumption | None = None


@dataclass(frozen=True, slots=True)
class Wanted:
    """The options as they were given.

    Attributes:
        scenario: the scenario file; None to take that of the run to go on with.
        fleet: the fleet file; likewise.
        settings: `name=value` for each parameter.
        bindings: `role=robot,robot` for each role.
        rate: a number or `max`.
        seed: of all randomness.
        resume: the folder of a run to go on with.
    """

    scenario: Path | None
    fleet: Path | None
    settings: Sequence[str] = ()
    bindings: Sequence[str] = ()
    rate: str | None = None
    seed: int | None = None
    resume: Path | None = field(default=None)


def read_order(wanted: Wanted) -> Order:
    """Read the files that the options name.

    Raises:
        ConfigError: with the problems of both files.
        ScenarioError: the run cannot go on with this scenario.
        BadParameter: an option does not say what it should, or names no run that can go on.
    """
    rate, binding = _rate(wanted.rate), _binding(wanted.bindings)
    if wanted.resume is not None:
        return _resumed(wanted, wanted.resume, rate)
    if wanted.scenario is None:
        raise typer.BadParameter("is missing", param_hint="'SCENARIO'")
    if wanted.fleet is None:
        raise typer.BadParameter("is missing", param_hint="'--fleet' / '-f'")
    scenario, config = _read_both(wanted.scenario, wanted.fleet, rate, wanted.seed)
    try:
        given = read_settings(scenario.file, wanted.settings)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="'--set'") from error
    return Order(with_parameters(scenario, given), config, binding)


def _resumed(wanted: Wanted, directory: Path, rate: Rate | None) -> Order:
    for hint, given in (("--set", wanted.settings), ("--bind", wanted.bindings), ("--seed", wanted.seed)):
        if given not in ((), [], None):
            raise typer.BadParameter("a run goes on with what it began with", param_hint=f"'{hint}'")
    try:
        resumption = read_run(directory)
    except ScenarioError as error:
        raise typer.BadParameter(str(error), param_hint="'--resume'") from error
    started: Mapping[str, Any] = resumption.started
    scenario, config = _read_both(
        wanted.scenario or Path(started["scenario_file"]),
        wanted.fleet or Path(started["fleet_file"]),
        rate if rate is not None else started["rate"],
        started["seed"],
    )
    scenario = with_parameters(scenario, started["parameters"])
    binding = {role: [*names, *started["spares"].get(role, ())] for role, names in started["roles"].items()}
    resumption.require_safe(scenario)
    return Order(scenario, config, binding, resumption)


def _rate(text: str | None) -> Rate | None:
    if text is None:
        return None
    if text == MAX:
        return MAX
    with contextlib.suppress(ValueError):
        if 0.001 <= (rate := float(text)) < math.inf:
            return rate
    raise typer.BadParameter(f"must be a number of at least 0.001, or {MAX}, not {text!r}", param_hint="'--rate'")


def _binding(texts: Sequence[str]) -> dict[str, list[str]] | None:
    found: dict[str, list[str]] = {}
    for text in texts:
        role, equals, names = text.partition("=")
        robots = [name.strip() for name in names.split(",") if name.strip()]
        if not equals or not role.strip() or not robots:
            raise typer.BadParameter(f"must be ROLE=ROBOT,ROBOT, not {text!r}", param_hint="'--bind'")
        if role.strip() in found:
            raise typer.BadParameter(f"binds role '{role.strip()}' twice", param_hint="'--bind'")
        found[role.strip()] = robots
    return found or None


def _read_both(scenario: Path, fleet: Path, rate: Rate | None, seed: int | None) -> tuple[Scenario, FleetConfig]:
    """Read both files, and raise ConfigError with the problems of both."""
    problems: list[Problem] = []
    wanted = _noting(problems, lambda: load_scenario(scenario))
    config = _noting(problems, lambda: read_fleet(fleet, rate=rate, seed=seed))
    if wanted is None or config is None:
        if config is not None:
            problems += check_plugins(config)[0]  # else found while it connects
        raise ConfigError(problems)
    return wanted, config


def _noting(problems: list[Problem], read: Callable[[], T]) -> T | None:
    try:
        return read()
    except ConfigError as error:
        problems += error.problems
        return None
