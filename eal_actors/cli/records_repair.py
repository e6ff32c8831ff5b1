"""`eal records`: repair the records of runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from eal_actors.cli.options import EalCommand, EalCommandGroup
from eal_actors.cli.output import print_line, stdout
from eal_actors.cli.records import reading_run
from eal_actors.kernel.errors import ScenarioError
from eal_actors.recording import RunFolder, repair_record

app = typer.Typer(cls=EalCommandGroup, help="Repair the records of runs.", no_args_is_help=True)


@app.callback()
def _records() -> None:
    """Keep `repair` a command of its own while it is the only one."""


@app.command("repair", cls=EalCommand)
def repair_runs(runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Folders of runs.")]) -> None:
    """Make the records of killed runs, and damaged ones, whole, so that every reader opens their run.mcap.

    What is lost of run.mcap is restored from events.jsonl and trajectory.csv as far as they have it. A damaged file is
    kept as run.mcap.damaged. A whole record stays as it is, and a run that is under way is refused. The next start of a
    run in the same folder of runs repairs those of killed runs too.
    """
    for run in runs:
        with reading_run():
            if _is_whole(RunFolder.open(run)):
                print_line(stdout(), f"{run}: is whole")
                continue
            end_s = repair_record(run)
        print_line(stdout(), f"{run}: repaired, {end_s:.1f} s")


def _is_whole(run: RunFolder) -> bool:
    try:
        return run.record.is_complete
    except ScenarioError:  # it is missing or damaged; a repair says so if nothing can be done
        return False
