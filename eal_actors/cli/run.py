"""`eal run`: carry out a scenario on a fleet."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, TypeVar

import typer
from rich.console import Console
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.interrupts import Interrupts
from eal_actors.cli.opening import advice_on_plugins, check_plugins, read_fleet
from eal_actors.cli.options import FleetOption, GlobalOptions, JsonOption
from eal_actors.cli.output import stderr, stdout, write_json
from eal_actors.cli.progress import new_progress
from eal_actors.cli.run_summary import print_summary
from eal_actors.clock import wall_time
from eal_actors.errors import ConfigError, PluginError, Problem
from eal_actors.facade.fleet import Fleet
from eal_actors.lock_step import MAX, Rate
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.recording import PoseRecorder, PoseSample, draw_trajectory, write_trajectory
from eal_actors.scenario import Plan, Report, Run, Scenario, load_scenario, make_plan
from eal_actors.scenario.plan import bind_roles

T = TypeVar("T")

_DESKTOPS: Final = ("DISPLAY", "WAYLAND_DISPLAY")
"""One of these is set where windows can be opened."""


def run_scenario(
    context: typer.Context,
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO", help="The scenario file.", show_default=False)],
    fleet: FleetOption,
    runs_dir: Annotated[Path, typer.Option(help="Where the run's folder is made.")] = Path("runs"),
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of all randomness, in place of the fleet file's.")
    ] = None,
    rate: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBER|max",
            help="Fleet seconds in one real second, in place of the fleet file's; max is as fast as it goes.",
        ),
    ] = None,
    as_json: JsonOption = False,
    no_plot: Annotated[bool, typer.Option("--no-plot", help="Draw no picture of the paths.")] = False,
    show: Annotated[bool, typer.Option("--show", help="Open the picture, where there is a desktop.")] = False,
) -> None:
    """Run a scenario on a fleet.

    Everything is checked before anything moves. Ctrl-C stops the run: the scenario's `finally` is carried out and
    every robot is halted; a second Ctrl-C skips what is left of `finally`.
    The run's folder keeps summary.json, events.jsonl, trajectory.csv and trajectory.png.
    """
    wanted, config = _read_both(scenario, fleet, _checked_rate(rate), seed)
    console = stderr() if as_json else stdout()
    options = context.find_object(GlobalOptions) or GlobalOptions()
    done = _carry_out(wanted, config, runs_dir, console, options)
    kept = _keep_paths(done, config, draw=not no_plot and done.interrupts < 2)
    if as_json:
        write_json(done.report.model_dump(mode="json"))
    else:
        print_summary(console, done.report)
    for what, file in (("run", done.directory), *((file.suffix[1:], file) for file in kept)):
        console.print(Text(f"{what}: {file}", style="dim"), soft_wrap=True)
    if show and kept and kept[-1].suffix == ".png" and any(map(os.environ.get, _DESKTOPS)):
        typer.launch(str(kept[-1]))
    if done.interrupts:
        raise typer.Exit(ExitCode.INTERRUPTED)
    if done.report.outcome != "done":
        raise typer.Exit(ExitCode.FAILED)


@dataclass(frozen=True, slots=True)
class _Done:
    """A run that is over.

    Attributes:
        report: what came of it.
        directory: its folder.
        paths: where each robot was, on the clock of the run.
        interrupts: how many signals came.
    """

    report: Report
    directory: Path
    paths: Mapping[str, Sequence[PoseSample]]
    interrupts: int


def _carry_out(
    scenario: Scenario, config: FleetConfig, runs_dir: Path, console: Console, options: GlobalOptions
) -> _Done:
    """Connect the robots that the scenario means, show and record the run, and disconnect them."""
    bound = {name for names in bind_roles(scenario, config).values() for name in names}
    with Fleet(config).connect(bound) as opened:
        with advice_on_plugins(opened):
            plan = _plan(scenario, opened)
        directory = _new_directory(runs_dir, scenario.name)
        progress = new_progress(console, opened, options)
        run = Run(plan, opened, directory, listeners=[progress.hear])
        taking_part = [name for name in plan.robots if name not in plan.lost]
        with progress, PoseRecorder(opened, taking_part) as recorder, Interrupts(run) as interrupts:
            report = interrupts.wait(run.start())
    return _Done(report, directory, recorder.paths_since(run.start_s), interrupts.count)


def _checked_rate(text: str | None) -> Rate | None:
    if text is None:
        return None
    if text == MAX:
        return MAX
    with contextlib.suppress(ValueError):
        if 0.001 <= (rate := float(text)) < math.inf:
            return rate
    raise typer.BadParameter(f"must be a number of at least 0.001, or {MAX}, not {text!r}", param_hint="'--rate'")


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


def _plan(scenario: Scenario, fleet: Fleet) -> Plan:
    """Make the plan; what the robots lack because a plugin did not connect is that plugin's fault, not the file's."""
    try:
        return make_plan(scenario, fleet)
    except ConfigError as error:
        if not fleet.problems:
            raise
        raise PluginError(f"{'; '.join(map(str, fleet.problems))}. So the scenario cannot run:\n{error}") from error


def _new_directory(runs_dir: Path, scenario: str) -> Path:
    """Make the run's folder; one that is there already is left alone."""
    name = f"{scenario}-{wall_time():%Y%m%dT%H%M%SZ}"
    number = 1
    while True:
        directory = runs_dir / (name if number == 1 else f"{name}-{number}")
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            number += 1
        except OSError as error:
            raise ConfigError([Problem(str(directory), 0, 0, "", f"cannot be made: {error.strerror}")]) from error
        else:
            return directory


def _keep_paths(done: _Done, config: FleetConfig, *, draw: bool) -> list[Path]:
    """Write where the robots were, if any of them knew; return the files."""
    if not any(done.paths.values()):
        return []
    table = done.directory / "trajectory.csv"
    write_trajectory(done.paths, table)
    picture = None
    if draw:
        report = done.report
        title = f"{report.scenario} on {report.fleet}: {report.outcome}"
        outcomes = {name: robot.outcome for name, robot in report.robots.items()}
        picture = draw_trajectory(done.paths, config.world, done.directory / "trajectory.png", title, outcomes)
    return [table, *([picture] if picture is not None else [])]
