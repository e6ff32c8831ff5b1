"""`eal sweep`: a scenario over ranges of its parameters and over seeds."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.options import FleetOption, JsonOption
from eal_actors.cli.output import counted, short_path, stderr, stdout, write_json
from eal_actors.cli.progress import STYLES
from eal_actors.cli.rehearse import KeepOption
from eal_actors.cli.run_options import Wanted, read_order
from eal_actors.kernel.errors import ConfigError
from eal_actors.lab.sweeping import (
    Job,
    Result,
    Sweep,
    SweepFolder,
    read_seeds,
    read_variations,
    run_all,
    write_csv,
    write_junit,
)
from eal_actors.lab.sweeping.folder import LOG
from eal_actors.lab.sweeping.picture import draw_sweep
from eal_actors.lab.sweeping.results import CRASHED, REFUSED
from eal_actors.lab.sweeping.worker import Task, Workplace
from eal_actors.managers.twins import simulated
from eal_actors.scenario.language.binding import find_candidates
from eal_actors.scenario.language.parameters import missing_parameters

T = TypeVar("T")
_LIMIT = 1000
_SHOWN_FAILURES = 10
Tell = Callable[[Result], None]


def sweep_scenario(
    scenario: Annotated[
        Path,
        typer.Argument(metavar="SCENARIO", help="The scenario file, or a shipped one by name.", show_default=False),
    ],
    fleet: FleetOption,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=FROM:TO:STEP",
            help="A parameter and its values, as a range with both ends or as a list, NAME=1,2,5; may be repeated.",
        ),
    ] = None,
    seeds: Annotated[
        str | None, typer.Option(metavar="1:20", show_default="the fleet file's", help="Seeds, such as 1:20 or 1,5,9.")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="A parameter that stays the same; may be repeated."),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", "-j", min=1, max=256, show_default="one for each processor", help="Processes."),
    ] = None,
    out: Annotated[Path | None, typer.Option(show_default="sweeps/<scenario>", help="The sweep's folder.")] = None,
    repeat: Annotated[bool, typer.Option("--repeat", help="Run those again too that are finished.")] = False,
    limit: Annotated[int, typer.Option(min=1, help="More runs than this are refused.")] = _LIMIT,
    keep: KeepOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run a scenario in simulation with every combination of values and every seed, in several processes.

    Every run goes as fast as the machine, and its folder is kept. A sweep that was cut off goes on when the same
    command is given again: runs that are finished are not run again. Then the folder holds table.csv, junit.xml and
    table.png.

    Ends with 1 if a run is not done, or an expectation of its failed.
    """
    order = read_order(Wanted(scenario, fleet, settings or ()))
    variations = _reading("--vary", lambda: read_variations(order.scenario, vary or (), limit))
    chosen = (order.config.seed,) if seeds is None else _reading("--seeds", lambda: read_seeds(seeds, limit))
    sweep = Sweep(order.scenario, order.config, tuple(keep or ()), variations, chosen)
    _require_sound(sweep, limit)
    folder = SweepFolder(out or Path("sweeps") / order.scenario.name)
    console = stderr() if as_json else stdout()
    with folder.open(sweep, repeat=repeat):
        logged_before = folder.logged_bytes
        results = _carry_out(console, folder, sweep, jobs or os.cpu_count() or 1)
        files = _write(folder, sweep, results)
    if as_json:
        write_json(_as_json(folder, sweep, results, files))
    else:
        _print(console, folder, sweep, results, files)
    if folder.logged_bytes > logged_before:
        console.print(Text(f"log: {folder.path / LOG}: the processes had something to say", "yellow"), soft_wrap=True)
    if not all(result.is_good for result in results):
        raise typer.Exit(ExitCode.FAILED)


def _reading(option: str, read: Callable[[], T]) -> T:
    """Return what an option means; what cannot be understood is the user's mistake, not a file's."""
    try:
        return read()
    except ConfigError:
        raise
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint=f"'{option}'") from error


def _require_sound(sweep: Sweep, limit: int) -> None:
    """Refuse what no run of the sweep could begin with."""
    if sweep.count > limit:
        sizes = [f"{len(variation.values)} values of {variation.name}" for variation in sweep.variations]
        product = " times ".join([*sizes, counted(len(sweep.seeds), "seed")])
        raise typer.BadParameter(
            f"{product} make {sweep.count} runs, more than {limit}; --limit {sweep.count} allows them",
            param_hint="'--vary'",
        )
    scenario = sweep.scenario
    given = {**scenario.parameters, **{variation.name: variation.values[0] for variation in sweep.variations}}
    if missing := missing_parameters(scenario.file, given, scenario.tree):
        raise ConfigError(missing)
    bound = find_candidates(scenario, sweep.fleet)
    simulated(sweep.fleet, {name for names in bound.values() for name in names}, sweep.keep)


def _carry_out(console: Console, folder: SweepFolder, sweep: Sweep, processes: int) -> list[Result]:
    """Carry out the runs that are not finished; return the results of all, in the order of the sweep."""
    jobs = list(sweep.jobs())
    failures: dict[str, Result] = {}
    waiting = [job for job in jobs if not folder.is_finished(job)]
    finished = len(jobs) - len(waiting)
    if finished:
        console.print(Text(f"{counted(finished, 'run')} of {len(jobs)} finished before", style="dim"))
    by_folder = {folder.directory_of(job): job for job in waiting}
    tasks = (Task(folder.clear(job), job.parameters, job.seed) for job in waiting)
    workplace = Workplace(
        sweep.scenario.source,
        sweep.scenario_hash,
        sweep.fleet.source,
        sweep.fleet_hash,
        sweep.keep,
        (folder.path / LOG).resolve(),
    )
    try:
        with _telling(console, finished, len(jobs)) as tell:
            for answer in run_all(tasks, workplace, min(processes, max(1, len(waiting)))):
                job = by_folder[answer.task.directory]
                if answer.error is not None:
                    outcome = CRASHED if answer.has_crashed else REFUSED
                    failures[job.name] = Result(job, outcome, error=answer.error)
                tell(failures.get(job.name) or folder.result(job, sweep.scenario))
    except KeyboardInterrupt:
        done = sum(folder.is_finished(job) for job in jobs)
        stderr().print(f"Stopped: {done} of {len(jobs)} runs are finished; the same command goes on.", style="yellow")
        raise
    return [failures.get(job.name) or folder.result(job, sweep.scenario) for job in jobs]


@contextmanager
def _telling(console: Console, finished: int, total: int) -> Iterator[Tell]:
    """Show progress: a bar on a terminal, a line for each run elsewhere. What fails is told at once on both."""
    if not console.is_terminal:
        number = finished

        def tell_line(result: Result) -> None:
            nonlocal number
            number += 1
            console.print(Text(f"{number}/{total}  ").append_text(_line(result)), soft_wrap=True)

        yield tell_line
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("runs", total=total, completed=finished)

        def tell_bar(result: Result) -> None:
            bar.advance(task)
            if not result.is_good:
                bar.console.print(_line(result), soft_wrap=True)

        yield tell_bar


def _line(result: Result) -> Text:
    outcome = result.outcome if result.outcome != "done" or result.is_good else "failed"
    text = Text.assemble(f"{result.job.label}  ", (outcome, STYLES.get(outcome, STYLES["failed"])))
    if result.duration_s is not None:
        text.append(f" after {result.duration_s:.2f} s")
    why = result.error or ", ".join(path for path, held in result.expected.items() if not held)
    return text.append(f": {why}") if why else text


def _write(folder: SweepFolder, sweep: Sweep, results: Sequence[Result]) -> list[Path]:
    """Write the table, the test cases and the picture; return the files."""
    table, junit = folder.path / "table.csv", folder.path / "junit.xml"
    write_csv(results, sweep.scenario, table)
    write_junit(results, f"sweep.{sweep.scenario.name}", junit)
    picture = draw_sweep(results, sweep.scenario, folder.path / "table.png") if sweep.variations else None
    return [table, junit, *([picture] if picture is not None else [])]


def _print(
    console: Console, folder: SweepFolder, sweep: Sweep, results: Sequence[Result], files: Sequence[Path]
) -> None:
    bad = [result for result in results if not result.is_good]
    if bad and console.is_terminal:  # elsewhere every run has its line
        console.print()
    verdict = (f"{len(bad)} of {counted(len(results), 'run')} failed", "bold red") if bad else ("all done", "green")
    console.print(
        Text.assemble(f"{sweep.scenario.name} on {sweep.fleet.name}, {counted(len(results), 'run')}: ", verdict),
        soft_wrap=True,
    )
    for result in bad[:_SHOWN_FAILURES]:
        line = Text("  ").append_text(_line(result)).append(f"  ({short_path(folder.directory_of(result.job))})", "dim")
        console.print(line, soft_wrap=True)
    if len(bad) > _SHOWN_FAILURES:
        console.print(Text(f"  and {len(bad) - _SHOWN_FAILURES} more; the table has all of them", style="dim"))
    for file in files:
        console.print(Text(f"{file.suffix[1:]}: {file}", style="dim"), soft_wrap=True)


def _as_json(folder: SweepFolder, sweep: Sweep, results: Sequence[Result], files: Sequence[Path]) -> dict[str, Any]:
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
                "run": _run_of(folder, result.job),
            }
            for result in results
        ],
    }


def _run_of(folder: SweepFolder, job: Job) -> str | None:
    return str(folder.directory_of(job)) if folder.is_finished(job) else None
