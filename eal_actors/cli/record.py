"""`eal record`: record a fleet that others command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from eal_actors.cli.completion import complete_robots
from eal_actors.cli.fleets import in_real_time, read_fleet
from eal_actors.cli.interrupts import handle_signals
from eal_actors.cli.options import FleetOption
from eal_actors.cli.output import counted, print_line, service_output
from eal_actors.cli.run_options import RecordOption, RunsDirOption
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import new_waiter
from eal_actors.managers.missing_modules import require_modules
from eal_actors.recording import LiveRecord, RunFolder, draw_run, new_run_folder, repair_interrupted


def record_fleet(
    fleet: FleetOption,
    robots: Annotated[
        list[str] | None,
        typer.Argument(metavar="[ROBOT...]", help="Only these robots.", autocompletion=complete_robots),
    ] = None,
    record: RecordOption = "sensors",
    duration_s: Annotated[
        float | None, typer.Option("--duration-s", min=0.1, show_default="until Ctrl-C", help="Seconds to record.")
    ] = None,
    runs_dir: RunsDirOption = Path("runs"),
) -> None:
    """Record the robots of a fleet while others command them, until Ctrl-C; nothing is commanded or halted.

    The folder is that of a run: `eal replay`, `eal report` and Foxglove open it. It also has the robots' losses.
    """
    handle_signals()
    config = in_real_time(read_fleet(fleet, robots or []))
    require_modules(config, config.robots)
    out = service_output()
    with Fleet(config).connect() as opened:
        repair_interrupted(runs_dir)
        directory = new_run_folder(runs_dir, "record")
        with LiveRecord(opened, directory, record):
            end = "Ctrl-C ends it" if duration_s is None else f"for {duration_s:g} s"
            try:
                print_line(out, f"recording {counted(len(opened), 'robot')} to {directory}: {end}")
                opened.clock.wait(new_waiter(), opened.clock.of_real(duration_s) if duration_s is not None else None)
            except KeyboardInterrupt:
                print_line(out, "ending the record", "dim")
        run = RunFolder.open(directory)
        if run.summary is not None and run.paths:
            draw_run(run, run.summary, config.world)
    print_line(out, f"run: {directory}")
    print_line(out, f"next: eal replay {directory}", "dim")
