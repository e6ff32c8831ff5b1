"""Arguments and options of `eal run`: their declarations for Typer, and the run that they request."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

from eal_actors.cli.fleets import check_plugins, read_fleet
from eal_actors.cli.options import bad_option
from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.lock_step import MAX, Rate
from eal_actors.managers.config import collect_problems
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.recording import Extent
from eal_actors.recording.provenance import FLEET, SCENARIO
from eal_actors.scenario import Resumption, Scenario, load_scenario, read_run
from eal_actors.scenario.language.parameters import read_settings, with_parameters

DryRunOption: TypeAlias = Annotated[
    bool, typer.Option("--dry-run", help="Check everything and print the plan; nothing moves.")
]
ResumeOption: TypeAlias = Annotated[
    Path | None, typer.Option(metavar="RUN", help="Continue the run of this folder after its controller died.")
]
EventsOption: TypeAlias = Annotated[
    str | None, typer.Option(metavar="FILE|-", help="Write the run's events as JSON lines; - is stdout.")
]
RecordOption: TypeAlias = Annotated[
    Extent, typer.Option(help="Content of run.mcap: poses; poses and sensor values; or camera frames as well.")
]
RunsDirOption: TypeAlias = Annotated[Path, typer.Option(help="Parent of the run's folder.")]
SeedOption: TypeAlias = Annotated[
    int | None, typer.Option(min=0, help="Seed of all randomness, instead of the fleet file's.")
]
RateOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        metavar="NUMBER|max",
        help="Fleet seconds per real second, instead of the fleet file's; max is as fast as possible.",
    ),
]
NoPlotOption: TypeAlias = Annotated[bool, typer.Option("--no-plot", help="Do not draw the paths.")]
StrictOption: TypeAlias = Annotated[
    bool, typer.Option("--strict", help="Exit with 1 also if the run is done without a robot that it dropped.")
]
LookaheadOption: TypeAlias = Annotated[
    float | None,
    typer.Option(
        min=1,
        max=60,
        metavar="SECONDS",
        help="Look so far ahead once a second: warn before contacts, low batteries and leaving the area.",
    ),
]
LookaheadHoldOption: TypeAlias = Annotated[
    bool, typer.Option("--lookahead-hold", help="With --lookahead: halt the robots concerned before they touch.")
]
FilmOption: TypeAlias = Annotated[bool, typer.Option("--film", help="Draw the run as a film too: trajectory.gif.")]
ShowOption: TypeAlias = Annotated[
    bool, typer.Option("--show", help="Show the drawing in the terminal if it can (kitty, iTerm2, sixel), or open it.")
]


@dataclass(frozen=True, slots=True)
class RunRequest:
    """A scenario to run on a fleet.

    `binding` has the robots by role, as the user bound them; None if the scenario binds them. `resumption` is the point
    at which an interrupted run continues.
    """

    scenario: Scenario
    config: FleetConfig
    binding: Mapping[str, Sequence[str]] | None = None
    resumption: Resumption | None = None


@dataclass(frozen=True, slots=True)
class RunOptions:
    """The options as the user gave them.

    Attributes:
        scenario: None for that of the resumed run; so is `fleet`.
        settings: `name=value` for each parameter.
        rate: a number or `max`.
    """

    scenario: Path | None
    fleet: Path | None
    settings: Sequence[str] = ()
    bindings: Sequence[str] = ()
    rate: str | None = None
    seed: int | None = None
    resume: Path | None = None


def read_request(options: RunOptions) -> RunRequest:
    """Read the files that the options name.

    Raises:
        ConfigError: a file is wrong; names the problems of both files.
        ScenarioError: the run cannot continue with this scenario.
        BadParameter: an option is wrong, or names no run that can continue.
    """
    rate, binding = parse_rate(options.rate), _parse_bindings(options.bindings)
    if options.resume is not None:
        return _resumed_request(options, options.resume, rate)
    if options.scenario is None:
        raise typer.BadParameter("is missing", param_hint="'SCENARIO'")
    if options.fleet is None:
        raise typer.BadParameter("is missing", param_hint="'--fleet' / '-f'")
    scenario, config = _read_both(options.scenario, options.fleet, rate, options.seed)
    with bad_option("--set"):
        given = read_settings(scenario.file, options.settings)
    return RunRequest(with_parameters(scenario, given), config, binding)


def _resumed_request(options: RunOptions, directory: Path, rate: Rate | None) -> RunRequest:
    for hint, given in (("--set", options.settings), ("--bind", options.bindings), ("--seed", options.seed)):
        if given not in ((), [], None):
            raise typer.BadParameter("not with --resume: the run keeps its values", param_hint=f"'{hint}'")
    with bad_option("--resume"):
        resumption = read_run(directory)
    started: Mapping[str, Any] = resumption.started
    scenario, config = _read_both(
        options.scenario or _kept(Path(started["scenario_file"]), directory / SCENARIO),
        options.fleet or _kept(Path(started["fleet_file"]), directory / FLEET),
        rate if rate is not None else started["rate"],
        started["seed"],
    )
    scenario = with_parameters(scenario, started["parameters"])
    binding = {role: [*names, *started["spares"].get(role, ())] for role, names in started["roles"].items()}
    resumption.require_safe(scenario)
    return RunRequest(scenario, config, binding, resumption)


def _kept(file: Path, copy: Path) -> Path:
    """Return a file of a run, or the copy in its folder on a machine that does not have the file."""
    return copy if not file.exists() and copy.exists() else file


def parse_rate(text: str | None) -> Rate | None:
    """Return the value of --rate. Raises BadParameter if it is neither a number of at least 0.001 nor `max`."""
    if text is None:
        return None
    if text == MAX:
        return MAX
    with contextlib.suppress(ValueError):
        if 0.001 <= (rate := float(text)) < math.inf:
            return rate
    raise typer.BadParameter(f"must be a number of at least 0.001, or {MAX}, not {text!r}", param_hint="'--rate'")


def _parse_bindings(texts: Sequence[str]) -> dict[str, list[str]] | None:
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
    """Read both files; raise ConfigError with the problems of both."""
    problems: list[Problem] = []
    loaded = collect_problems(problems, lambda: load_scenario(scenario))
    config = collect_problems(problems, lambda: read_fleet(fleet, rate=rate, seed=seed))
    if loaded is None or config is None:
        if config is not None:
            problems += check_plugins(config)[0]  # otherwise the fleet's connection finds them
        raise ConfigError(problems)
    return loaded, config
