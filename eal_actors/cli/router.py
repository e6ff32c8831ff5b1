"""`eal router`: pass on what robots and controllers that cannot reach each other have to say."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.text import Text

from eal_actors.cli.options import GlobalOptions
from eal_actors.cli.output import stderr
from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.log import get_logger
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.network_model import SECURE_PROTOCOLS, parse_endpoint
from eal_actors.net.session import open_session, router_config

DEFAULT_PORT: Final = 7447


def run_router(
    context: typer.Context,
    listen: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ENDPOINT",
            show_default=f"tcp/0.0.0.0:{DEFAULT_PORT}, or tls/... for a fleet with security",
            help="Where to listen; may be repeated.",
        ),
    ] = None,
    connect: Annotated[
        list[str] | None,
        typer.Option(metavar="ENDPOINT", show_default=False, help="Another router to join; may be repeated."),
    ] = None,
    fleet: Annotated[
        Path | None,
        typer.Option("--fleet", "-f", show_default=False, help="Keep to the network and security of this fleet file."),
    ] = None,
    name: Annotated[
        str, typer.Option(help="Name of the router's certificate, where the fleet has security.")
    ] = "router",
) -> None:
    """Run a router, to which robots and controllers dial out, until Ctrl-C or SIGTERM.

    Robots reach it whose address is `router` in the fleet file, and whose network.routers names it.
    """
    config = None if fleet is None else EALConfigManager.load(fleet).fleet
    places = listen or [_default_endpoint(config)]
    settings = router_config(_checked(places, "--listen"), _checked(connect or [], "--connect"), config, name)
    with open_session(settings):
        try:
            _tell(places, context.find_object(GlobalOptions) or GlobalOptions())
            REAL_TIME.wait(new_waiter(), None)
        except KeyboardInterrupt:  # as SIGTERM counts too
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            get_logger().info("the router stops")


def _default_endpoint(fleet: FleetConfig | None) -> str:
    is_secure = fleet is not None and fleet.network.security is not None
    return f"{SECURE_PROTOCOLS[0] if is_secure else 'tcp'}/0.0.0.0:{DEFAULT_PORT}"


def _checked(endpoints: list[str], option: str) -> list[str]:
    for endpoint in endpoints:
        try:
            parse_endpoint(endpoint)
        except ValueError as error:
            raise typer.BadParameter(str(error), param_hint=option) from None
    return endpoints


def _tell(places: list[str], options: GlobalOptions) -> None:
    """Say that it listens: a log line for programs, whatever the level, or a line for people."""
    if options.log_format == "json":
        get_logger().warning("the router listens", endpoints=places)
    else:
        stderr().print(Text(f"The router listens at {', '.join(places)}; Ctrl-C ends it."), soft_wrap=True)
