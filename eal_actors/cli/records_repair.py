"""`eal records`: repair the records of runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from eal_actors.cli.options import EalCommand, EalCommandGroup
from eal_actors.cli.output import print_line, stdout
from eal_actors.cli.records import reading_run
from eal_actors.recording import RunFolder, repair_record
from eal_actors.recording.mcap_file import RECORD_FILE

app = typer.Typer(cls=EalCommandGroup, help="Repair the records of runs.", no_args_is_help=True)


@app.callback()
def _records() -> None:
    """Keep `repair` a command of its own while it is the only one."""


@app.command("repair", cls=EalCommand)
def repair_runs(runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Folders of runs.")]) -> None:
    """Make the records of killed runs whole, so that every reader opens their run.mcap.

    The lost end of run.mcap is restored from events.jsonl and trajectory.csv, which lose nothing. A whole record stays
    as it is, and a run that is under way is refused. The next start of a run in the same folder of runs does this too.
    """
    for run in runs:
        with reading_run():
            folder = RunFolder.open(run)
            if (run / RECORD_FILE).is_file() and folder.record.is_complete:
                print_line(stdout(), f"{run}: is whole")
                continue
            end_s = repair_record(run)
        print_line(stdout(), f"{run}: repaired, {end_s:.1f} s")
