"""`eal router`: forward messages between robots and controllers that cannot reach each other directly."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Annotated, Final

import typer

from eal_actors.cli.options import GlobalOptions
from eal_actors.cli.output import print_line, service_output
from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.log import get_logger
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.network_model import SECURE_PROTOCOLS, parse_endpoint
from eal_actors.wire.session import router_config
from eal_actors.wire.session_keeper import router_session

DEFAULT_PORT: Final = 7447


def run_router(
    context: typer.Context,
    listen: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ENDPOINT",
            show_default=f"the port of the fleet's routers, else tcp/0.0.0.0:{DEFAULT_PORT}, or tls/... with security",
            help="Endpoint to listen at; repeatable.",
        ),
    ] = None,
    connect: Annotated[
        list[str] | None, typer.Option(metavar="ENDPOINT", help="Endpoint of another router to join; repeatable.")
    ] = None,
    fleet: Annotated[
        Path | None, typer.Option("--fleet", "-f", help="Fleet file whose network and security settings to use.")
    ] = None,
    name: Annotated[str, typer.Option(help="Name of the router's certificate, for a fleet with security.")] = "router",
) -> None:
    """Run a router, to which robots and controllers dial out, until Ctrl-C or SIGTERM.

    It serves robots whose address in the fleet file is `router`; network.routers must list its endpoint.
    """
    config = None if fleet is None else EALConfigManager.load(fleet).fleet
    endpoints = listen or [default_endpoint(config)]
    _validate(endpoints, "--listen")
    _validate(connect or [], "--connect")
    with router_session(config, name, lambda: router_config(endpoints, connect or [], config, name)):
        try:
            if GlobalOptions.of(context).log_format == "json":
                get_logger().warning("the router listens", endpoints=endpoints)  # of a visible level
            else:
                print_line(
                    service_output(sys.stderr), f"The router listens at {', '.join(endpoints)}; Ctrl-C stops it."
                )
            REAL_TIME.wait(new_waiter(), None)
        except KeyboardInterrupt:  # SIGTERM raises it too
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            get_logger().info("the router stops")


def default_endpoint(fleet: FleetConfig | None) -> str:
    """Return where a router listens: at the port of the fleet's routers, if all of them have the same."""
    routers = {(it.protocol, it.port) for it in map(parse_endpoint, () if fleet is None else fleet.network.routers)}
    is_secure = fleet is not None and fleet.network.security is not None
    usual = SECURE_PROTOCOLS[0] if is_secure else "tcp", DEFAULT_PORT
    protocol, port = routers.pop() if len(routers) == 1 else usual
    return f"{protocol}/0.0.0.0:{port}"


def _validate(endpoints: list[str], option: str) -> None:
    for endpoint in endpoints:
        try:
            parse_endpoint(endpoint)
        except ValueError as error:
            raise typer.BadParameter(str(error), param_hint=option) from None
