"""`--foxglove`: a live view of a command's fleet for Foxglove and Lichtblick."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from eal_actors.facade.fleet import Fleet
from eal_actors.managers.missing_modules import needs_extra

if TYPE_CHECKING:
    from eal_actors.operate.foxglove import LiveView

FoxgloveOption = Annotated[
    str | None,
    typer.Option(
        "--foxglove",
        metavar="[HOST:]PORT",
        help="Serve a live view for Foxglove and Lichtblick; on loopback unless a host is given.",
    ),
]
FoxgloveControlOption = Annotated[
    bool,
    typer.Option(
        "--foxglove-control", help="Let viewers drive robots and set configuration keys. Viewers have no passwords."
    ),
]


@contextmanager
def foxglove_at(place: str | None, fleet: Fleet, console: Console, *, allow_control: bool) -> Iterator[LiveView | None]:
    """Serve a live view if a place is given, and print its URL.

    Raises:
        UnsupportedError: foxglove-sdk is not installed.
        BadParameter: the place is no port.
        UnavailableError: the port is in use.
    """
    if place is None:
        if allow_control:
            raise typer.BadParameter("needs --foxglove", param_hint="'--foxglove-control'")
        yield None
        return
    host, _, port = place.rpartition(":")
    if not port.isdecimal() or int(port) > 65535:
        raise typer.BadParameter(f"{place!r} is no [HOST:]PORT, such as 8765", param_hint="'--foxglove'")
    with needs_extra("foxglove", "the live view needs"):
        from eal_actors.operate.foxglove import LiveView
    with LiveView(fleet, host or "127.0.0.1", int(port), allow_control=allow_control) as view:
        console.print(f"Foxglove: {view.url}", soft_wrap=True)
        yield view
