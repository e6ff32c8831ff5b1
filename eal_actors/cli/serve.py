"""`eal serve`: offer a robot's resources to the network."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.text import Text

from eal_actors.cli.interrupts import heed_signals
from eal_actors.cli.metrics import MetricsPortOption, metrics_at
from eal_actors.cli.opening import read_fleet
from eal_actors.cli.options import FleetOption
from eal_actors.cli.output import stdout
from eal_actors.cli.trace import TraceOption, traces_to
from eal_actors.facade.service import RobotService


def serve_robot(
    fleet: FleetOption,
    robot: Annotated[str, typer.Option("--robot", "-r", help="The robot's name.", show_default=False)],
    metrics_port: MetricsPortOption = None,
    trace: TraceOption = None,
) -> None:
    """Run a robot in this process, and serve its resources at its address until Ctrl-C or SIGTERM.

    Controllers use the same fleet file. When this ends, everything that moves is halted.
    """
    heed_signals()
    out = stdout()
    with traces_to(trace, f"eal serve {robot}", out), RobotService(read_fleet(fleet, [robot]), robot) as service:
        try:
            resources = ", ".join(service.robot)
            out.print(Text.assemble((robot, "bold"), f" serves {resources}"), soft_wrap=True)
            how = "dials out to" if service.is_behind_router else "listening at"
            out.print(f"{how} {', '.join(service.endpoints)}", soft_wrap=True)
            robots = {robot: service.robot}
            with metrics_at(metrics_port, robots, service.robot.clock, out, service.dead_man_trips):
                service.wait()
        except KeyboardInterrupt:
            out.print("halting and leaving the network")
