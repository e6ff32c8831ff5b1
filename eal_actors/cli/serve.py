"""`eal serve`: serve a robot's resources on the network."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.text import Text

from eal_actors.cli.fleets import read_fleet
from eal_actors.cli.interrupts import handle_signals
from eal_actors.cli.options import FleetOption
from eal_actors.cli.output import print_line, stdout
from eal_actors.cli.telemetry import MetricsPortOption, TraceOption, metrics_at, traces_to
from eal_actors.facade.service import RobotService


def serve_robot(
    fleet: FleetOption,
    robot: Annotated[str, typer.Option("--robot", "-r", help="Name of the robot.", show_default=False)],
    metrics_port: MetricsPortOption = None,
    trace: TraceOption = None,
) -> None:
    """Run a robot in this process, and serve its resources at its address until Ctrl-C or SIGTERM.

    Controllers use the same fleet file. The robot halts when the command ends.
    """
    handle_signals()
    out = stdout()
    with traces_to(trace, f"eal serve {robot}", out), RobotService(read_fleet(fleet, [robot]), robot) as service:
        try:
            print_line(out, Text.assemble((robot, "bold"), f" serves {', '.join(service.robot)}"))
            how = "dials out to" if service.is_behind_router else "listening at"
            print_line(out, f"{how} {', '.join(service.endpoints)}")
            robots = {robot: service.robot}
            with metrics_at(metrics_port, robots, service.robot.clock, out, service.dead_man_trips):
                service.wait()
        except KeyboardInterrupt:
            out.print("halting and leaving the network")
