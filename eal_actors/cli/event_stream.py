"""`eal run --events`: what happens, as JSON lines, while it happens."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Final

import typer

from eal_actors.kernel.log import get_logger
from eal_actors.scenario import Listener, RunEvent
from eal_actors.scenario.report.records import as_json

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
        try:
            stream = Path(target).open("w", encoding="utf-8")  # noqa: SIM115  # closing it may fail, on a full disk
        except OSError as error:
            why = os.strerror(error.errno) if error.errno else str(error)
            raise typer.BadParameter(f"{target} cannot be written: {why}", param_hint="'--events'") from error
        try:
            yield [_writer(stream)]
        finally:
            with suppress(OSError):  # what was not written was told of already
                stream.close()


def _writer(stream: IO[str]) -> Listener:
    is_open = True

    def write(event: RunEvent) -> None:
        nonlocal is_open
        if not is_open:
            return
        try:
            stream.write(as_json(event.to_dict()) + "\n")
            stream.flush()
        except OSError as error:  # a full disk, or nobody reads any more: the run goes on
            is_open = False
            get_logger().error("the stream of events ends here", reason=str(error))

    return write
