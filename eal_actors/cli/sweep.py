"""`eal sweep`: run a scenario over ranges of its parameters and over seeds."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.options import (
    FleetOption,
    JobsOption,
    JsonOption,
    KeepOption,
    ScenarioArgument,
    SettingsOption,
    bad_option,
)
from eal_actors.cli.output import counted, print_line, stderr, stdout, write_json
from eal_actors.cli.progress import STYLES
from eal_actors.cli.run_options import RunOptions, read_request
from eal_actors.cli.work import work_progress
from eal_actors.kernel.bundled import short_path
from eal_actors.kernel.errors import ConfigError, writing
from eal_actors.lab.sweeping.folder import LOG, SweepFolder
from eal_actors.lab.sweeping.plot import draw_sweep
from eal_actors.lab.sweeping.results import CRASHED, REFUSED, SweepResult, write_csv, write_junit
from eal_actors.lab.sweeping.sweep import Sweep
from eal_actors.lab.sweeping.variations import read_seeds, read_variations
from eal_actors.lab.sweeping.worker import SweepTask, SweepWorker
from eal_actors.lab.worker_pool import run_all
from eal_actors.managers.twins import simulated
from eal_actors.scenario.language.binding import bound_robots
from eal_actors.scenario.language.parameters import missing_parameters

_LIMIT = 1000
_SHOWN_FAILURES = 10


def sweep_scenario(
    scenario: ScenarioArgument,
    fleet: FleetOption,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=FROM:TO:STEP",
            help="A parameter with a range of values that includes both ends, or a list: NAME=1,2,5; repeatable.",
        ),
    ] = None,
    seeds: Annotated[
        str | None, typer.Option(metavar="1:20", show_default="the fleet file's", help="Seeds, such as 1:20 or 1,5,9.")
    ] = None,
    settings: SettingsOption = None,
    jobs: JobsOption = None,
    out: Annotated[Path | None, typer.Option(show_default="sweeps/<scenario>", help="Folder of the sweep.")] = None,
    repeat: Annotated[bool, typer.Option("--repeat", help="Run finished runs again too.")] = False,
    limit: Annotated[int, typer.Option(min=1, help="Largest number of runs.")] = _LIMIT,
    keep: KeepOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run a scenario in simulation with every combination of values and every seed, in several processes.

    Every run is as fast as possible, and its folder is kept. To resume an interrupted sweep, run the same command
    again: finished runs are skipped. At the end the folder contains table.csv, junit.xml and table.png.

    The exit code is 1 if a run is not done, or if one of its expectations failed.
    """
    request = read_request(RunOptions(scenario, fleet, settings or ()))
    with bad_option("--vary"):
        variations = read_variations(request.scenario, vary or (), limit)
    with bad_option("--seeds"):
        chosen = (request.config.seed,) if seeds is None else read_seeds(seeds, limit)
    sweep = Sweep(request.scenario, request.config, tuple(keep or ()), variations, chosen)
    _validate(sweep, limit)
    folder = SweepFolder(out or Path("sweeps") / request.scenario.name)
    console = stderr() if as_json else stdout()
    with ExitStack() as stack:
        with bad_option("--out"):
            stack.enter_context(folder.open(sweep, repeat=repeat))
        logged_before = folder.logged_bytes
        results = _run_sweep(console, folder, sweep, jobs or os.cpu_count() or 1)
        files = _write_results(folder, sweep, results)
    if as_json:
        write_json(_sweep_as_json(folder, sweep, results, files))
    else:
        _print_sweep(console, folder, sweep, results, files)
    if folder.logged_bytes > logged_before:
        print_line(console, f"log: {folder.path / LOG}: workers logged warnings", "yellow")
    if not all(result.is_good for result in results):
        raise typer.Exit(ExitCode.FAILED)


def _validate(sweep: Sweep, limit: int) -> None:
    """Raise an error if no run of the sweep could start."""
    if sweep.count > limit:
        sizes = [f"{len(variation.values)} values of {variation.name}" for variation in sweep.variations]
        product = " times ".join([*sizes, counted(len(sweep.seeds), "seed")])
        raise typer.BadParameter(
            f"{product} make {sweep.count} runs, more than {limit}; --limit {sweep.count} allows them",
            param_hint="'--vary'",
        )
    scenario = sweep.scenario
    given = {**scenario.parameters, **{variation.name: variation.values[0] for variation in sweep.variations}}
    if missing := missing_parameters(scenario, given):
        raise ConfigError(missing)
    simulated(sweep.fleet, bound_robots(scenario, sweep.fleet), sweep.keep)


def _run_sweep(console: Console, folder: SweepFolder, sweep: Sweep, processes: int) -> list[SweepResult]:
    """Perform the runs that are not finished; return the results of all runs, in the order of the sweep."""
    jobs = list(sweep.jobs())
    failures: dict[str, SweepResult] = {}
    waiting = [job for job in jobs if not folder.is_finished(job)]
    finished = len(jobs) - len(waiting)
    if finished:
        console.print(Text(f"{counted(finished, 'run')} of {len(jobs)} finished before", style="dim"))
    by_folder = {folder.directory_of(job): job for job in waiting}
    tasks = (SweepTask(folder.clear(job), job.parameters, job.seed) for job in waiting)
    perform = SweepWorker(sweep.scenario.source, sweep.scenario_hash, sweep.fleet.source, sweep.fleet_hash, sweep.keep)
    log = (folder.path / LOG).resolve()
    try:
        with work_progress(console, "run", len(jobs), finished) as on_done:
            for ended in run_all(tasks, perform, log, processes):
                job = by_folder[ended.task.directory]
                if ended.error is not None:
                    outcome = CRASHED if ended.has_crashed else REFUSED
                    failures[job.name] = SweepResult(job, outcome, error=ended.error)
                result = failures.get(job.name) or folder.result(job, sweep.scenario)
                on_done(_result_line(result), not result.is_good)
    except KeyboardInterrupt:
        done = sum(folder.is_finished(job) for job in jobs)
        text = f"Stopped: {done} of {len(jobs)} runs are finished; run the same command to resume."
        print_line(stderr(), text, "yellow")
        raise
    return [failures.get(job.name) or folder.result(job, sweep.scenario) for job in jobs]


def _result_line(result: SweepResult) -> Text:
    outcome = result.outcome if result.outcome != "done" or result.is_good else "failed"
    text = Text.assemble(f"{result.job.label}  ", (outcome, STYLES.get(outcome, STYLES["failed"])))
    if result.duration_s is not None:
        text.append(f" after {result.duration_s:.2f} s")
    reason = result.error or ", ".join(path for path, held in result.expected.items() if not held)
    return text.append(f": {reason}") if reason else text


def _write_results(folder: SweepFolder, sweep: Sweep, results: Sequence[SweepResult]) -> list[Path]:
    table, junit = folder.path / "table.csv", folder.path / "junit.xml"
    with writing(folder.path):
        write_csv(results, sweep.scenario, table)
        write_junit(results, f"sweep.{sweep.scenario.name}", junit)
        plot = draw_sweep(results, sweep.scenario, folder.path / "table.png") if sweep.variations else None
    return [table, junit, *([plot] if plot is not None else [])]


def _print_sweep(
    console: Console, folder: SweepFolder, sweep: Sweep, results: Sequence[SweepResult], files: Sequence[Path]
) -> None:
    bad = [result for result in results if not result.is_good]
    if bad and console.is_terminal:  # elsewhere every run has its line already
        console.print()
    verdict = (f"{len(bad)} of {counted(len(results), 'run')} failed", "bold red") if bad else ("all done", "green")
    title = f"{sweep.scenario.name} on {sweep.fleet.name}, {counted(len(results), 'run')}: "
    print_line(console, Text.assemble(title, verdict))
    for result in bad[:_SHOWN_FAILURES]:
        directory = short_path(folder.directory_of(result.job))
        print_line(console, Text("  ").append_text(_result_line(result)).append(f"  ({directory})", "dim"))
    if len(bad) > _SHOWN_FAILURES:
        console.print(Text(f"  and {len(bad) - _SHOWN_FAILURES} more; the table lists all of them", style="dim"))
    for file in files:
        print_line(console, f"{file.suffix[1:]}: {file}", "dim")


def _sweep_as_json(
    folder: SweepFolder, sweep: Sweep, results: Sequence[SweepResult], files: Sequence[Path]
) -> dict[str, Any]:
    return {
        "scenario": sweep.scenario.name,
        "fleet": sweep.fleet.name,
        "folder": str(folder.path),
        "files": [str(file) for file in files],
        "failed": sum(not result.is_good for result in results),
        "runs": [
            {
                "parameters": dict(result.job.varied),
                "seed": result.job.seed,
                "outcome": result.outcome,
                "duration_s": result.duration_s,
                "expected": dict(result.expected),
                "variables": dict(result.variables),
                "error": result.error or None,
                "run": str(folder.directory_of(result.job)) if folder.is_finished(result.job) else None,
            }
            for result in results
        ],
    }
