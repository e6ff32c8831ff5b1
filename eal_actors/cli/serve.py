"""`eal serve`: serve robots' resources on the network."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import partial
from typing import Annotated

import typer
from rich.console import Console
from rich.text import Text

from eal_actors.cli.exit_codes import report_error
from eal_actors.cli.fleets import read_fleet
from eal_actors.cli.interrupts import handle_signals, reload_at_hangup
from eal_actors.cli.options import FleetOption, GlobalOptions
from eal_actors.cli.output import print_line, service_output
from eal_actors.cli.telemetry import MetricsPortOption, TraceOption, metrics_at, traces_to
from eal_actors.facade.service import RobotService, serve_together
from eal_actors.kernel.errors import ConfigError, EALError, Problem
from eal_actors.lab.fleet_edits import write_identity
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.network_model import IDENTITY_VARIABLE


def serve_robot(
    context: typer.Context,
    fleet: FleetOption,
    robot: Annotated[list[str], typer.Option("--robot", "-r", help="Name of a robot; repeatable.")],
    metrics_port: MetricsPortOption = None,
    trace: TraceOption = None,
) -> None:
    """Run a robot in this process, and serve its resources at its address until Ctrl-C or SIGTERM.

    Controllers use the same fleet file. The robot halts when the command ends. SIGHUP reads the fleet file again.
    Several robots share the process: so all robots and trackers of one simulated world. Those of one address share a
    link.

    If other machines can reach the robot, and the fleet has neither an identity nor keys, an identity is written into
    the fleet file. Robots and controllers with another one do not hear each other.
    """
    handle_signals()
    out, names = service_output(), list(dict.fromkeys(robot))
    if metrics_port is not None and len(names) > 1:
        raise typer.BadParameter("needs one robot for each process", param_hint="'--metrics-port'")
    config = _with_identity(read_fleet(fleet, names), out)
    with traces_to(trace, f"eal serve {' '.join(names)}", out), _served(config, names) as services:
        service = services[0]
        reload_at_hangup(partial(_reload, service, out, GlobalOptions.of(context)))
        try:
            for one in services:
                print_line(out, Text.assemble((one.robot.name, "bold"), f" serves {', '.join(one.robot)}"))
                how = "dials out to" if one.is_behind_router else "listening at"
                print_line(out, f"{how} {', '.join(one.endpoints)}")
            print_line(out, _identity_line(config))
            robots = {one.robot.name: one.robot for one in services}
            with metrics_at(metrics_port, robots, service.robot.clock, out, service.dead_man_trips):
                _wait(services)
        except KeyboardInterrupt:
            out.print("halting and leaving the network")


def _with_identity(config: FleetConfig, out: Console) -> FleetConfig:
    """Return the fleet with an identity, unless it has keys or only programs of this machine reach the robots.

    Raises ConfigError if its file cannot be changed.
    """
    if not config.needs_identity(config.robots):
        return config
    try:
        write_identity(config)
    except ConfigError as error:
        text = f"other machines reach {' and '.join(config.robots)}: set `identity` here, or ${IDENTITY_VARIABLE}"
        raise ConfigError([*error.problems, Problem(str(config.source), 0, 0, "network", text)]) from error
    written = read_fleet(config.source, list(config.robots))
    where = f"{written.network.identity} into {config.source}"
    print_line(out, f"wrote identity {where}: copy the file to the fleet's other machines")
    return written


def _identity_line(config: FleetConfig) -> str:
    if config.network.identity is not None:
        return f"fleet {config.name}, identity {config.network.identity}"
    if config.network.security is not None:
        return f"fleet {config.name}"
    return f"fleet {config.name}, no identity: programs of this machine with a fleet of this name command it"


@contextmanager
def _served(config: FleetConfig, robots: list[str]) -> Iterator[tuple[RobotService, ...]]:
    if len(robots) > 1:
        with serve_together(config, robots) as services:
            yield services
    else:
        with RobotService(config, robots[0]) as service:
            yield (service,)


def _wait(services: tuple[RobotService, ...]) -> None:
    """Wait until a service ends; raise its error."""
    if len(services) == 1:
        services[0].wait()
        return
    pool = ThreadPoolExecutor(len(services), "waits for a service")
    try:
        ended, _ = wait([pool.submit(service.wait) for service in services], return_when=FIRST_COMPLETED)
        for one in ended:
            one.result()
    finally:
        pool.shutdown(wait=False)  # the threads end when the services are closed


def _reload(service: RobotService, out: Console, options: GlobalOptions) -> None:
    try:
        print_line(out, f"reloaded: {service.reload()}")
    except EALError as error:
        report_error(error, options, console=service_output(sys.stderr))
