"""Output streams that may fail during a run: stdout and stderr, and the JSON lines of `eal run --events`.

A closed pipe, a closed terminal or a full disk must not end a run: the robots would stop in the middle of a step. So
output is discarded after the first failed write. The exit code reports output that was lost, but not a reader that
closed its pipe on purpose, such as `head`.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, TextIO, cast

import typer

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.output import json_output
from eal_actors.kernel.log import get_logger

if TYPE_CHECKING:
    from eal_actors.scenario import Listener, RunEvent

STDOUT: Final = "-"
_READER_GONE: Final = (errno.EPIPE, errno.EIO)  # errors of writing to a closed pipe and to a closed terminal


class _FailsafeStream:
    """A text stream that discards its output after a failed write instead of raising.

    A character that its encoding lacks, such as an en dash on a Latin-1 terminal, is written as an escape. `failure` is
    the error that lost output; None if nothing was lost or if only the reader has gone.
    """

    def __init__(self, stream: TextIO) -> None:
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
        self._stream = stream
        self.failure: OSError | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except OSError as error:
            self._discard_output(error)
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError as error:
            self._discard_output(error)

    def _discard_output(self, error: OSError) -> None:
        """Redirect the stream and its buffer to the null device; report the error unless nobody reads."""
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, self._stream.fileno())
        os.close(null)
        if error.errno not in _READER_GONE:
            self.failure = error
            sys.stderr.write(f"Error: {self._stream.name.strip('<>')} cannot be written: {error.strerror}\n")


@contextmanager
def failsafe_output() -> Iterator[None]:
    """Discard the output of stdout and stderr where they are closed or cannot be written, instead of raising.

    Raises SystemExit with 1 instead of 0 if output was lost.
    """
    sys.stdin = sys.stdin or _open_null("r")
    streams = [_FailsafeStream(stream or _open_null("w")) for stream in (sys.stdout, sys.stderr)]
    sys.stdout, sys.stderr = (cast("TextIO", stream) for stream in streams)
    try:
        yield
    except SystemExit as ended:
        for stream in streams:
            stream.flush()
        if any(stream.failure for stream in streams):
            raise SystemExit(ended.code or ExitCode.FAILED) from None
        raise


def _open_null(mode: str) -> TextIO:
    return cast("TextIO", Path(os.devnull).open(mode, encoding="utf-8"))


@contextmanager
def event_stream(target: str | None) -> Iterator[list[Listener]]:
    """Yield the listener that writes each event as a JSON line to a file, or to stdout for `-`; none without a target.

    Raises BadParameter if the file cannot be written.
    """
    if target is None:
        yield []
    elif target == STDOUT:
        yield [_event_writer(json_output())]
    else:
        try:
            stream = Path(target).open("w", encoding="utf-8")  # noqa: SIM115  # closing it may fail, on a full disk
        except OSError as error:
            why = os.strerror(error.errno) if error.errno else str(error)
            raise typer.BadParameter(f"{target} cannot be written: {why}", param_hint="'--events'") from error
        try:
            yield [_event_writer(stream)]
        finally:
            with suppress(OSError):  # the failed write was reported already
                stream.close()


def _event_writer(stream: IO[str]) -> Listener:
    from eal_actors.scenario.report.records import as_json

    is_open = True

    def write(event: RunEvent) -> None:
        nonlocal is_open
        if not is_open:
            return
        try:
            stream.write(as_json(event.to_dict()) + "\n")
            stream.flush()
        except OSError as error:  # a full disk, or the reader has gone: the run continues
            is_open = False
            get_logger().error("no further events are written", reason=str(error))

    return write
