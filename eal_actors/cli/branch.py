"""`eal branch` and `eal bisect`: another future of a recorded run, and the version that changed its record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.options import JsonOption, SettingsOption, bad_option
from eal_actors.cli.output import counted, print_line, stderr, stdout, write_json
from eal_actors.cli.progress import STYLES
from eal_actors.cli.records import RunArgument, reading_run
from eal_actors.cli.run_options import RunsDirOption
from eal_actors.lab.branching.bisect import bisect
from eal_actors.lab.branching.branch import BranchRequest, branch, parse_fault
from eal_actors.lab.branching.past import read_input
from eal_actors.recording import RunFolder
from eal_actors.recording.provenance import kept_scenario
from eal_actors.scenario import load_scenario
from eal_actors.scenario.language.parameters import read_settings


def branch_run(
    run: RunArgument,
    at: Annotated[float, typer.Option("--at", min=0, metavar="T", help="When, in seconds since the run's start.")],
    without_fault: Annotated[
        list[str] | None,
        typer.Option(metavar="[ROBOT.]FAULT", help="From then on without this fault of the fleet file; repeatable."),
    ] = None,
    with_fault: Annotated[
        list[str] | None,
        typer.Option(metavar="ROBOT.FAULT[=VALUE]", help="From then on with this fault, such as a.dead; repeatable."),
    ] = None,
    settings: SettingsOption = None,
    scenario: Annotated[
        Path | None, typer.Option(help="Another version of the scenario; its past must be the same.")
    ] = None,
    runs_dir: RunsDirOption = Path("runs"),
    as_json: JsonOption = False,
) -> None:
    """Repeat a simulated run up to a time, and continue it differently.

    The run must have been made with `--rate max`. The past is the same to the bit, which is checked. `--set` changes
    parameters for the steps that begin later. `eal diff RUN BRANCH --page FILE` shows both trails.
    """
    with bad_option("--with-fault"):
        added = dict(parse_fault(text) for text in with_fault or ())
    if not (without_fault or added or settings or scenario):
        raise typer.BadParameter("give --without-fault, --with-fault, --set or --scenario")
    with reading_run():
        RunFolder.open(run)  # names a folder that is none of a run
        file = load_scenario(scenario or kept_scenario(run)).file
        past = read_input(run)
    with bad_option("--set"):
        parameters = read_settings(file, settings or ())
    request = BranchRequest(past, at, without_fault or (), added, parameters, scenario)
    with bad_option("--at"):
        request.require_time()
    with bad_option("--without-fault"):
        request.require_planned()
    with bad_option("--with-fault"):
        request.require_injectable()
    with reading_run():
        made = branch(request, runs_dir)
    first = None if made.first is None else f"{made.first.where}: {made.first.left}, now {made.first.right}"
    if as_json:
        facts = {"run": str(made.directory), "outcome": made.report.outcome, "duration_s": made.report.duration_s}
        write_json({**facts, "first_difference": first})
        return
    console = stdout()
    print_line(console, f"same past, to the bit, up to {at:g} s")
    print_line(console, f"first difference: {first}" if first else "no difference up to the end")
    outcome = (made.report.outcome, STYLES[made.report.outcome])
    print_line(console, Text.assemble("the branch: ", outcome, f" after {made.report.duration_s:.2f} s"))
    print_line(console, f"run: {made.directory}", "dim")
    print_line(console, f"next: eal diff {run} {made.directory} --page difference.html", "dim")


def bisect_run(
    run: RunArgument,
    good: Annotated[str, typer.Option(help="A version: a scenario file, or a git revision.")],
    bad: Annotated[str, typer.Option(help="A later version.")],
    as_json: JsonOption = False,
) -> None:
    """Find the version of the scenario, or of the framework, at which the record of a run first differs.

    The run is repeated with each tried version, on its own fleet, seed and parameters. Revisions are those of the git
    repository in the working directory. The exit code is 1 if a version differs.
    """
    console = stderr() if as_json else stdout()
    with reading_run():
        found = bisect(
            run, good, bad, lambda version, same: print_line(console, f"{version}: {'same' if same else 'differs'}")
        )
    where = None if found.first is None else f"{found.first.where}: {found.first.left}, now {found.first.right}"
    if as_json:
        write_json({"version": found.version, "first_difference": where, "runs": found.tried})
    elif where is None:
        print_line(console, f"no difference between {good} and {bad}")
    else:
        print_line(console, f"first difference, after {counted(found.tried, 'run')}: {found.version}")
        print_line(console, f"  {where}")
    if where is not None:
        raise typer.Exit(ExitCode.FAILED)
