"""`--metrics-port`: Prometheus metrics of a command's robots."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Annotated

import typer
from rich.console import Console

from eal_actors.actors.handles import RobotHandle
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import UnsupportedError

MetricsPortOption = Annotated[
    int | None,
    typer.Option(
        "--metrics-port",
        min=0,
        max=65535,
        show_default=False,
        help="Serve Prometheus metrics at this port on loopback; 0 for any free port.",
    ),
]


@contextmanager
def metrics_at(
    port: int | None,
    robots: Mapping[str, RobotHandle],
    clock: Clock,
    console: Console,
    dead_man_trips: Mapping[str, int] | None = None,
) -> Iterator[None]:
    """Serve metrics of robots if a port is given, and print the URL.

    Raises:
        UnsupportedError: prometheus-client is not installed.
        UnavailableError: the port is in use.
    """
    if port is None:
        yield
        return
    try:
        from eal_actors.operate.metrics.fleet_metrics import FleetMetrics
    except ModuleNotFoundError as error:
        raise UnsupportedError(
            f"metrics need {error.name}, which is not installed: pip install 'eal-actors[metrics]'"
        ) from error
    with FleetMetrics(robots, clock, port, dead_man_trips) as metrics:
        console.print(f"metrics at {metrics.url}", soft_wrap=True)
        yield
