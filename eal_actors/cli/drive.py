"""`eal drive`: drive robots with a gamepad or a keyboard of this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from eal_actors.cli.completion import complete_robots
from eal_actors.cli.fleets import in_real_time, read_fleet
from eal_actors.cli.interrupts import handle_signals
from eal_actors.cli.options import FleetOption
from eal_actors.cli.output import print_line, stdout
from eal_actors.facade.fleet import Fleet
from eal_actors.managers.missing_modules import needs_extra


def drive_robots(
    robots: Annotated[
        list[str], typer.Argument(metavar="ROBOT...", help="Names of robots.", autocompletion=complete_robots)
    ],
    fleet: FleetOption,
    device: Annotated[
        Path | None,
        typer.Option(
            show_default="the first gamepad",
            help="An input device such as /dev/input/event5, of a gamepad or a keyboard; or a stream of its events.",
        ),
    ] = None,
    speed_m_s: Annotated[float, typer.Option("--speed-m-s", min=0.01, max=10, help="Speed at the stick's end.")] = 0.2,
    turn_rad_s: Annotated[float, typer.Option("--turn-rad-s", min=0.01, max=20, help="Turn at the stick's end.")] = 0.8,
    expo: Annotated[float, typer.Option(min=0, max=1, help="The stick's curve: 0 linear, 1 cubic.")] = 0.6,
    silence_s: Annotated[
        float, typer.Option("--silence-s", min=0.2, max=60, help="Halt if the device sends nothing for so long.")
    ] = 3.0,
) -> None:
    """Drive robots with a gamepad or a keyboard, until Ctrl-C; then all robots are halted.

    A gamepad drives with its left stick while a shoulder button is held; a keyboard with W A S D or the arrow keys.
    The robots halt when it is released or unplugged, or falls silent. Start, Select or Tab chooses among several
    robots: all, or one after another.
    """
    with needs_extra("gamepad", "a gamepad needs"):
        from eal_actors.operate.hands import HandDriver, HandSettings, find_input

        source = find_input(device)
    handle_signals()
    out = stdout()
    try:
        with Fleet(in_real_time(read_fleet(fleet, robots))).connect() as opened:
            settings = HandSettings(speed_m_s, turn_rad_s, expo, silence_s)
            print_line(out, f"{source.name}: hold a shoulder button, or W A S D, to drive {', '.join(opened)}")
            HandDriver(opened, list(opened), settings, lambda line: print_line(out, line)).run(source)
    except KeyboardInterrupt:
        out.print("halting the robots")
    finally:
        source.close()
