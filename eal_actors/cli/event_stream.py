"""`eal run --events`: what happens, as JSON lines, while it happens."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Final

import typer

from eal_actors.scenario import Event, Listener

STDOUT: Final = "-"


@contextmanager
def event_stream(target: str | None) -> Iterator[list[Listener]]:
    """Yield the listener that writes each event to a file, or to stdout for `-`; none without a target.

    Raises:
        BadParameter: the file cannot be written.
    """
    if target is None:
        yield []
    elif target == STDOUT:
        yield [_writer(sys.stdout)]
    else:
        with ExitStack() as stack:
            try:
                stream = stack.enter_context(Path(target).open("w", encoding="utf-8"))
            except OSError as error:
                why = os.strerror(error.errno) if error.errno else str(error)
                raise typer.BadParameter(f"{target} cannot be written: {why}", param_hint="'--events'") from error
            yield [_writer(stream)]


def _writer(stream: IO[str]) -> Listener:
    def write(event: Event) -> None:
        stream.write(json.dumps(event.to_dict()) + "\n")
        stream.flush()

    return write
