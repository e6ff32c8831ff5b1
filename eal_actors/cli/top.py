"""`eal top`: watch and stop a fleet in the terminal."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, TextIO, cast

import typer

from eal_actors.cli.fleets import in_real_time, read_fleet
from eal_actors.cli.interrupts import handle_signals
from eal_actors.cli.options import FleetOption, GlobalOptions, RobotsArgument
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import UnsupportedError
from eal_actors.kernel.log import configure_logging
from eal_actors.managers.missing_modules import needs_extra, require_modules
from eal_actors.operate.metrics.call_observer import observe_calls


def show_top(
    context: typer.Context,
    fleet: FleetOption,
    robots: RobotsArgument = None,
    runs_dir: Annotated[Path, typer.Option(help="The folder of the runs' records.")] = Path("runs"),
) -> None:
    """Watch a fleet in the terminal: robots, commands, mailboxes, calls, and the progress of the newest run.

    s stops every robot and r resumes; enter shows a robot's details; q quits. Calls are those of this process. For a
    robot on the network without such calls, the latency is that of pings; `eal serve --metrics-port` reports all calls.
    """
    with needs_extra("top", "eal top needs"):
        from eal_actors.operate.top.call_statistics import RecentCalls
        from eal_actors.operate.top.screen import LogBuffer, TopApp
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise UnsupportedError("eal top needs a terminal; programs can use `eal ping --json`")
    handle_signals()
    config = in_real_time(read_fleet(fleet, robots or ()))
    require_modules(config, config.robots)
    options = GlobalOptions.of(context)
    calls, lines = RecentCalls(), LogBuffer()
    with Fleet(config).connect() as opened:
        clock = opened.clock
        configure_logging("human", options.log_level, cast("TextIO", lines))
        try:
            with observe_calls(clock, lambda call, _, taken_s: calls.add(call.cell.robot, clock.now(), taken_s)):
                TopApp(opened, calls, runs_dir, lines).run()
        finally:
            configure_logging(options.log_format, options.log_level)
