"""`eal run`: carry out a scenario on a fleet."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import typer
from rich.console import Console
from rich.text import Text

from eal_actors.cli.event_stream import STDOUT, event_stream
from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.interrupts import Interrupts
from eal_actors.cli.metrics import MetricsPortOption, metrics_at
from eal_actors.cli.opening import advice_on_plugins
from eal_actors.cli.options import GlobalOptions, JsonOption
from eal_actors.cli.output import stderr, stdout, write_json
from eal_actors.cli.progress import new_progress
from eal_actors.cli.run_arguments import (
    BindingsOption,
    DryRunOption,
    EventsOption,
    FleetOption,
    NoPlotOption,
    RateOption,
    RecordOption,
    ResumeOption,
    RunsDirOption,
    ScenarioArgument,
    SeedOption,
    SettingsOption,
    ShowOption,
)
from eal_actors.cli.run_keys import RunKeys
from eal_actors.cli.run_options import Order, Wanted, read_order
from eal_actors.cli.run_plan import plan_as_json, print_plan
from eal_actors.cli.run_summary import print_summary
from eal_actors.cli.trace import TraceOption, traces_to
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError, PluginError
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.recording import (
    Extent,
    RunFolder,
    RunRecorder,
    draw_run,
    folder_errors,
    keep_provenance,
    new_run_folder,
    repair_record,
)
from eal_actors.recording.run_folder import TRAJECTORY
from eal_actors.scenario import Listener, Plan, Report, Run, make_plan
from eal_actors.scenario.language.binding import find_candidates

_DESKTOPS: Final = ("DISPLAY", "WAYLAND_DISPLAY")
"""One of these is set where windows can be opened."""


def run_scenario(
    context: typer.Context,
    scenario: ScenarioArgument = None,
    fleet: FleetOption = None,
    settings: SettingsOption = None,
    bindings: BindingsOption = None,
    dry_run: DryRunOption = False,
    resume: ResumeOption = None,
    events: EventsOption = None,
    record: RecordOption = "poses",
    runs_dir: RunsDirOption = Path("runs"),
    seed: SeedOption = None,
    rate: RateOption = None,
    as_json: JsonOption = False,
    metrics_port: MetricsPortOption = None,
    trace: TraceOption = None,
    no_plot: NoPlotOption = False,
    show: ShowOption = False,
) -> None:
    """Run a scenario on a fleet.

    Everything is checked before anything moves. On a terminal, the space bar pauses and goes on, s lets each robot
    take one step, and q stops. Ctrl-C stops the run: the scenario's `finally` is carried out and
    every robot is halted; a second Ctrl-C skips what is left of `finally`.
    The run's folder keeps summary.json, events.jsonl, trajectory.csv, trajectory.png and run.mcap; `eal report` makes a
    page of it.
    """
    _require_one_on_stdout(events, as_json=as_json)
    order = read_order(Wanted(scenario, fleet, settings or (), bindings or (), rate, seed, resume))
    console = stderr() if as_json or events == STDOUT else stdout()
    if dry_run:
        _tell_plan(order, console, as_json=as_json)
        return
    with event_stream(events) as listeners, traces_to(trace, "eal run", console):
        options = context.find_object(GlobalOptions) or GlobalOptions()
        done = _carry_out(order, runs_dir, console, options, listeners, record, metrics_port)
    _show(done, order.config, console, as_json=as_json, draw=not no_plot, open_picture=show)
    if done.interrupts or done.report.outcome != "done":
        raise typer.Exit(ExitCode.INTERRUPTED if done.interrupts else ExitCode.FAILED)


def _require_one_on_stdout(events: str | None, *, as_json: bool) -> None:
    if as_json and events == STDOUT:
        raise typer.BadParameter("stdout takes the events or the summary of --json, not both", param_hint="'--events'")


def _show(done: _Done, config: FleetConfig, console: Console, *, as_json: bool, draw: bool, open_picture: bool) -> None:
    """Tell what came of a run, draw its paths, and say where it all is."""
    if as_json:
        write_json(done.report.model_dump(mode="json"))
    else:
        print_summary(console, done.report)
    _tell_where(console, "run", done.directory)
    kept = _draw_paths(done, config, draw=draw and done.interrupts < 2)
    for file in kept:
        _tell_where(console, file.suffix[1:], file)
    if open_picture and kept and kept[-1].suffix == ".png" and any(map(os.environ.get, _DESKTOPS)):
        typer.launch(str(kept[-1]))


def _tell_where(console: Console, what: str, path: Path) -> None:
    console.print(Text(f"{what}: {path}", style="dim"), soft_wrap=True)


def _tell_plan(order: Order, console: Console, *, as_json: bool) -> None:
    """Make the plan on the connected robots, and print it."""
    with Fleet(order.config).connect(_bound(order)) as opened:
        with advice_on_plugins(opened):
            plan = _plan(order, opened)
        if as_json:
            write_json(plan_as_json(plan, opened.name))
        else:
            print_plan(console, plan, opened.name)


@dataclass(frozen=True, slots=True)
class _Done:
    """A run that is over.

    Attributes:
        report: what came of it.
        directory: its folder.
        interrupts: how many signals came.
    """

    report: Report
    directory: Path
    interrupts: int


def _bound(order: Order) -> set[str]:
    return {name for names in find_candidates(order.scenario, order.config, order.binding).values() for name in names}


def _carry_out(
    order: Order,
    runs_dir: Path,
    console: Console,
    options: GlobalOptions,
    listeners: Sequence[Listener],
    extent: Extent,
    metrics_port: int | None,
) -> _Done:
    """Connect the robots that the scenario means, show and record the run, and disconnect them."""
    with (
        Fleet(order.config).connect(_bound(order)) as opened,
        metrics_at(metrics_port, opened, opened.clock, console),
    ):
        with advice_on_plugins(opened):
            plan = _plan(order, opened)
        resumption = order.resumption
        directory = resumption.directory if resumption is not None else new_run_folder(runs_dir, plan.scenario.name)
        progress = new_progress(console, opened, options)
        with folder_errors(directory):
            if resumption is not None:
                resumption = replace(resumption, time_s=repair_record(directory))
            _keep_provenance(directory, order, plan)
            recorder = RunRecorder(opened, [name for name in plan.robots if name not in plan.lost], directory, extent)
        run = Run(plan, opened, directory, [progress.hear, recorder.hear, *listeners], resumption)
        with ExitStack() as stack:
            stack.enter_context(progress)
            stack.enter_context(recorder)
            interrupts = stack.enter_context(Interrupts(run))
            stack.enter_context(RunKeys(run))
            report = interrupts.wait(run.start())
    return _Done(report, directory, interrupts.count)


def _plan(order: Order, fleet: Fleet) -> Plan:
    """Make the plan; what the robots lack because a plugin did not connect is that plugin's fault, not the file's."""
    try:
        return make_plan(order.scenario, fleet, binding=order.binding)
    except ConfigError as error:
        if not fleet.problems:
            raise
        raise PluginError(f"{'; '.join(map(str, fleet.problems))}. So the scenario cannot run:\n{error}") from error


def _keep_provenance(directory: Path, order: Order, plan: Plan) -> None:
    """Write what is run into its folder; what a run goes on with, whose controller died, stands beside that."""
    if order.resumption is not None:
        directory = directory / f"continued-{len(order.resumption.continued_s) + 1}"
        directory.mkdir(exist_ok=True)
    keep_provenance(directory, order.config, plan.scenario)


def _draw_paths(done: _Done, config: FleetConfig, *, draw: bool) -> list[Path]:
    """Draw where the robots were, if any of them knew; return the files."""
    run = RunFolder.open(done.directory)
    if not run.paths:
        return []
    picture = draw_run(run, done.report, config.world) if draw else None
    return [done.directory / TRAJECTORY, *([picture] if picture is not None else [])]
