"""`--trace`: OpenTelemetry traces of what a command does."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Final

import typer
from rich.console import Console

from eal_actors.kernel.errors import ArgumentError, UnsupportedError

TraceOption = Annotated[
    str | None,
    typer.Option(
        "--trace",
        metavar="URL|otlp|console",
        envvar="OTEL_TRACES_EXPORTER",
        show_default=False,
        help="Send traces to an OpenTelemetry collector, to the collector of the OTEL_* variables, or to stderr.",
    ),
]

_NONE: Final = "none"
"""The value of OTEL_TRACES_EXPORTER for no traces."""


@contextmanager
def traces_to(where: str | None, service: str, console: Console) -> Iterator[None]:
    """Trace this process if requested, and print the destination.

    Args:
        where: see tracing.exporter_to; None or `none` for no traces.
        service: the name of the process.
        console: the console to print to.

    Raises:
        UnsupportedError: OpenTelemetry is not installed.
        BadParameter: the destination is invalid.
    """
    if where in (None, _NONE):
        yield
        return
    try:
        from eal_actors.operate.tracing import Tracing
    except ModuleNotFoundError as error:
        raise UnsupportedError(
            f"traces need {error.name}, which is not installed: pip install 'eal-actors[otel]'"
        ) from error
    try:
        tracing = Tracing(where, service)
    except ArgumentError as error:
        raise typer.BadParameter(error.message, param_hint="'--trace'") from error
    with tracing:
        console.print(f"traces to {where}", soft_wrap=True)
        yield
