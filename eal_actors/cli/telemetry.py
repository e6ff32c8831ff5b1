"""`--metrics-port` and `--trace`: Prometheus metrics of a command's robots, and OpenTelemetry traces."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Annotated, Final

import typer
from rich.console import Console

from eal_actors.actors.handles import RobotHandle
from eal_actors.cli.options import bad_option
from eal_actors.kernel.clock import Clock
from eal_actors.managers.missing_modules import needs_extra

MetricsPortOption = Annotated[
    int | None,
    typer.Option(
        "--metrics-port",
        min=0,
        max=65535,
        help="Serve Prometheus metrics at this port on loopback; 0 for any free port.",
    ),
]
TraceOption = Annotated[
    str | None,
    typer.Option(
        "--trace",
        metavar="URL|otlp|console",
        envvar="OTEL_TRACES_EXPORTER",
        help="Send traces to an OpenTelemetry collector, to the collector of the OTEL_* variables, or to stderr.",
    ),
]

_NONE: Final = "none"  # the value of OTEL_TRACES_EXPORTER for no traces


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
    with needs_extra("metrics", "metrics need"):
        from eal_actors.operate.metrics.fleet_metrics import FleetMetrics
    with FleetMetrics(robots, clock, port, dead_man_trips) as metrics:
        console.print(f"metrics at {metrics.url}", soft_wrap=True)
        yield


@contextmanager
def traces_to(where: str | None, service: str, console: Console) -> Iterator[None]:
    """Trace this process if requested, and print the destination; see `tracing.exporter_to`. `none` requests no traces.

    Raises:
        UnsupportedError: OpenTelemetry is not installed.
        BadParameter: the destination is invalid.
    """
    if where in (None, _NONE):
        yield
        return
    with needs_extra("otel", "traces need"):
        from eal_actors.operate.tracing import Tracing
    with bad_option("--trace"):
        tracing = Tracing(where, service)
    with tracing:
        console.print(f"traces to {where}", soft_wrap=True)
        yield
