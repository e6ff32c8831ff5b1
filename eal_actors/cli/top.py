"""`eal top`: a fleet in the terminal, with a key that stops it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, TextIO, cast

import typer

from eal_actors.cli.interrupts import heed_signals
from eal_actors.cli.opening import read_fleet
from eal_actors.cli.options import FleetOption, GlobalOptions, RobotsArgument
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import UnsupportedError
from eal_actors.kernel.lock_step import MAX
from eal_actors.kernel.log import configure_logging
from eal_actors.operate.metrics.call_observer import CallObserver


def show_top(
    context: typer.Context,
    fleet: FleetOption,
    robots: RobotsArgument = None,
    runs_dir: Annotated[Path, typer.Option(help="Where runs write down how far they have come.")] = Path("runs"),
) -> None:
    """Watch a fleet in the terminal: robots, what they do, mailboxes, calls, and how far the newest run has come.

    s stops every robot and r resumes; enter shows a robot in detail; q quits. Calls are those of this process: of
    robots that are served elsewhere, the latency is that of pings where there are none, and `eal serve --metrics-port`
    tells the rest.
    """
    try:
        from eal_actors.operate.top.call_statistics import RecentCalls
        from eal_actors.operate.top.screen import LogBuffer, TopApp
    except ModuleNotFoundError as error:
        raise UnsupportedError(
            f"eal top needs {error.name}, which is not installed: pip install 'eal-actors[top]'"
        ) from error
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise UnsupportedError("eal top needs a terminal; `eal ping --json` tells programs how robots are")
    heed_signals()
    config = read_fleet(fleet, robots or ())
    if config.rate == MAX:
        config = read_fleet(fleet, robots or (), rate=1.0)  # as fast as the machine goes is no pace for people
    options = context.find_object(GlobalOptions) or GlobalOptions()
    calls, lines = RecentCalls(), LogBuffer()
    with Fleet(config).connect() as opened:
        clock = opened.clock
        configure_logging("human", options.log_level, cast("TextIO", lines))
        try:
            with CallObserver(clock, lambda call, _, took_s: calls.note(call.cell.robot, clock.now(), took_s)):
                TopApp(opened, calls, runs_dir, lines).run()
        finally:
            configure_logging(options.log_format, options.log_level)
