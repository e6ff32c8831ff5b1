"""`eal run`: run a scenario on a fleet."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import typer
from rich.console import Console

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.fleets import plugin_advice
from eal_actors.cli.interrupts import RunInterrupts
from eal_actors.cli.live_view import FoxgloveControlOption, FoxgloveOption, foxglove_at
from eal_actors.cli.options import (
    BindingsOption,
    GlobalOptions,
    JsonOption,
    OptionalFleetOption,
    OptionalScenarioArgument,
    SettingsOption,
)
from eal_actors.cli.output import json_alone, print_line, stderr, stdout, write_json
from eal_actors.cli.progress import new_progress
from eal_actors.cli.run_ahead import Ahead, rehearse_ahead
from eal_actors.cli.run_keys import RunKeys
from eal_actors.cli.run_options import (
    DryRunOption,
    EventsOption,
    FilmOption,
    LookaheadHoldOption,
    LookaheadOption,
    NoPlotOption,
    RateOption,
    RecordOption,
    ResumeOption,
    RunOptions,
    RunRequest,
    RunsDirOption,
    SeedOption,
    ShowOption,
    StrictOption,
    read_request,
)
from eal_actors.cli.run_output import plan_as_json, print_plan, print_summary
from eal_actors.cli.streams import STDOUT, event_stream
from eal_actors.cli.telemetry import MetricsPortOption, TraceOption, metrics_at, traces_to
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError, PluginError
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.missing_modules import require_modules
from eal_actors.recording import (
    Extent,
    RunFolder,
    RunRecorder,
    draw_run,
    film_run,
    folder_errors,
    keep_provenance,
    new_run_folder,
    repair_interrupted,
    repair_record,
)
from eal_actors.recording.run_folder import TRAJECTORY
from eal_actors.scenario import Listener, Plan, Report, Run, Scenario, make_plan
from eal_actors.scenario.language.binding import bound_robots

if TYPE_CHECKING:
    from eal_actors.operate.foxglove import LiveView

_DESKTOPS: Final = ("DISPLAY", "WAYLAND_DISPLAY")  # environment variables, one of which is set if there is a desktop


def run_scenario(
    context: typer.Context,
    scenario: OptionalScenarioArgument = None,
    fleet: OptionalFleetOption = None,
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
    foxglove: FoxgloveOption = None,
    foxglove_control: FoxgloveControlOption = False,
    trace: TraceOption = None,
    no_plot: NoPlotOption = False,
    film: FilmOption = False,
    show: ShowOption = False,
    strict: StrictOption = False,
    lookahead: LookaheadOption = None,
    lookahead_hold: LookaheadHoldOption = False,
) -> None:
    """Run a scenario on a fleet.

    Everything is checked before a robot moves. On a terminal, the space bar pauses and resumes the run, s lets each
    robot do one step, q stops the run. Ctrl-C stops the run too: its `finally` steps run, then every robot halts.
    A second Ctrl-C skips the rest of `finally`.
    The run's folder gets summary.json, events.jsonl, trajectory.csv, trajectory.png and run.mcap; `eal report` makes
    an HTML page of them.
    """
    if as_json and events == STDOUT:
        raise typer.BadParameter("--events - and --json cannot both write to stdout", param_hint="'--events'")
    if events == STDOUT:
        context.with_resource(json_alone())
    request = read_request(RunOptions(scenario, fleet, settings or (), bindings or (), rate, seed, resume))
    console = stderr() if as_json or events == STDOUT else stdout()
    if dry_run:
        _print_dry_run(request, console, as_json=as_json)
        return
    ahead = rehearse_ahead(request, lookahead, holds=lookahead_hold)
    with event_stream(events) as listeners, traces_to(trace, "eal run", console):
        view = partial(foxglove_at, foxglove, console=console, allow_control=foxglove_control)
        finished = _execute(
            request, runs_dir, console, GlobalOptions.of(context), listeners, record, metrics_port, view, ahead
        )
    drawings = _Drawings(not no_plot and finished.interrupts < 2, film and finished.interrupts < 2, show)
    _show(finished, request.config, console, drawings, as_json=as_json)
    if (code := finished.exit_code(strict=strict)) is not None:
        raise typer.Exit(code)


@dataclass(frozen=True, slots=True)
class _FinishedRun:
    """A run that has ended: its report, its scenario, its folder, and the number of signals received."""

    report: Report
    scenario: Scenario
    directory: Path
    interrupts: int

    def exit_code(self, *, strict: bool) -> ExitCode | None:
        """Return the exit code of a run that is not done, or with `strict` lost a robot; else None."""
        if self.interrupts:
            return ExitCode.INTERRUPTED
        is_lacking = strict and bool(self.report.dropped)
        return ExitCode.FAILED if self.report.outcome != "done" or is_lacking else None


class _Drawings(NamedTuple):
    """The drawings of a run: the picture, the film, and whether to show them."""

    picture: bool
    film: bool
    show: bool


def _show(finished: _FinishedRun, config: FleetConfig, console: Console, drawings: _Drawings, *, as_json: bool) -> None:
    if as_json:
        write_json(finished.report.model_dump(mode="json"))
    else:
        print_summary(console, finished.report, finished.scenario)
    print_line(console, f"run: {finished.directory}", "dim")
    files = {file.suffix[1:]: file for file in _draw_paths(finished, config, drawings)}
    for kind, file in files.items():
        print_line(console, f"{kind}: {file}", "dim")
    if drawings.show and "png" in files:
        from eal_actors.cli.inline_picture import show_inline  # few terminals show pictures

        if not show_inline(console.file, files["png"], files.get("gif")) and any(map(os.environ.get, _DESKTOPS)):
            typer.launch(str(files.get("gif", files["png"])))


def _print_dry_run(request: RunRequest, console: Console, *, as_json: bool) -> None:
    robots = bound_robots(request.scenario, request.config, request.binding)
    require_modules(request.config, robots)
    with Fleet(request.config).connect(robots) as opened:
        with plugin_advice(opened):
            plan = _plan(request, opened)
        if as_json:
            write_json(plan_as_json(plan, opened.name))
        else:
            print_plan(console, plan, opened.name)


def _execute(
    request: RunRequest,
    runs_dir: Path,
    console: Console,
    options: GlobalOptions,
    listeners: Sequence[Listener],
    extent: Extent,
    metrics_port: int | None,
    view: Callable[[Fleet], AbstractContextManager[LiveView | None]],
    ahead: Ahead | None,
) -> _FinishedRun:
    """Connect the robots of the scenario, show and record the run, and disconnect them."""
    robots = bound_robots(request.scenario, request.config, request.binding)
    require_modules(request.config, robots)
    with (
        Fleet(request.config).connect(robots) as opened,
        metrics_at(metrics_port, opened, opened.clock, console),
        view(opened) as live,
    ):
        with plugin_advice(opened):
            plan = _plan(request, opened)
        resumption = request.resumption
        repair_interrupted(runs_dir)
        directory = resumption.directory if resumption is not None else new_run_folder(runs_dir, plan.scenario.name)
        progress = new_progress(console, opened, options)
        with folder_errors(directory):
            kept = directory
            if resumption is not None:
                resumption = replace(resumption, time_s=repair_record(directory))
                kept = directory / f"continued-{len(resumption.continued_s) + 1}"  # its inputs have their own folder
                kept.mkdir(exist_ok=True)
            keep_provenance(kept, request.config, plan.scenario)
            recorder = RunRecorder(opened, [name for name in plan.robots if name not in plan.lost], directory, extent)
        watcher = ahead.watcher(opened, plan) if ahead is not None else None
        heard = [progress.on_event, recorder.hear, *(part.hear for part in (live, watcher) if part is not None)]
        run = Run(plan, opened, directory, [*heard, *listeners], resumption)
        with ExitStack() as stack:
            stack.enter_context(progress)
            stack.enter_context(recorder)
            interrupts = stack.enter_context(RunInterrupts(run))
            stack.enter_context(RunKeys(run))
            if watcher is not None:
                watcher.attach(run)
                stack.enter_context(watcher)
            report = run.start().get()
    return _FinishedRun(report, plan.scenario, directory, interrupts.count)


def _plan(request: RunRequest, fleet: Fleet) -> Plan:
    """Make the plan; if it fails while a plugin is not connected, name that plugin as the cause, not the file."""
    try:
        return make_plan(request.scenario, fleet, binding=request.binding)
    except ConfigError as error:
        if not fleet.problems:
            raise
        raise PluginError(f"{'; '.join(map(str, fleet.problems))}. So the scenario cannot run:\n{error}") from error


def _draw_paths(finished: _FinishedRun, config: FleetConfig, drawings: _Drawings) -> list[Path]:
    """Draw the paths of the robots, if any pose was recorded; return the files."""
    run = RunFolder.open(finished.directory)
    if not run.paths:
        return []
    picture = draw_run(run, finished.report, config.world) if drawings.picture else None
    film = film_run(run, config.world) if drawings.film else None
    return [file for file in (finished.directory / TRAJECTORY, picture, film) if file is not None]
