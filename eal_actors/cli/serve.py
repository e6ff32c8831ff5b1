"""`eal serve`: serve a robot's resources on the network."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import typer
from rich.console import Console
from rich.text import Text

from eal_actors.cli.exit_codes import report_error
from eal_actors.cli.fleets import read_fleet
from eal_actors.cli.interrupts import handle_signals, reload_at_hangup
from eal_actors.cli.options import FleetOption, GlobalOptions
from eal_actors.cli.output import print_line, stdout
from eal_actors.cli.telemetry import MetricsPortOption, TraceOption, metrics_at, traces_to
from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import EALError


def serve_robot(
    context: typer.Context,
    fleet: FleetOption,
    robot: Annotated[str, typer.Option("--robot", "-r", help="Name of the robot.", show_default=False)],
    metrics_port: MetricsPortOption = None,
    trace: TraceOption = None,
) -> None:
    """Run a robot in this process, and serve its resources at its address until Ctrl-C or SIGTERM.

    Controllers use the same fleet file. The robot halts when the command ends. SIGHUP reads the fleet file again.
    """
    handle_signals()
    out = stdout()
    with traces_to(trace, f"eal serve {robot}", out), RobotService(read_fleet(fleet, [robot]), robot) as service:
        reload_at_hangup(partial(_reload, service, out, context.find_object(GlobalOptions) or GlobalOptions()))
        try:
            print_line(out, Text.assemble((robot, "bold"), f" serves {', '.join(service.robot)}"))
            how = "dials out to" if service.is_behind_router else "listening at"
            print_line(out, f"{how} {', '.join(service.endpoints)}")
            robots = {robot: service.robot}
            with metrics_at(metrics_port, robots, service.robot.clock, out, service.dead_man_trips):
                service.wait()
        except KeyboardInterrupt:
            out.print("halting and leaving the network")


def _reload(service: RobotService, out: Console, options: GlobalOptions) -> None:
    try:
        print_line(out, f"reloaded: {service.reload()}")
    except EALError as error:
        report_error(error, options)
