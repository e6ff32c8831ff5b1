"""Output that may go away while the program works: a closed pipe or terminal, a full disk, streams that nobody gave."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TextIO, cast

from eal_actors.cli.exit_codes import ExitCode

_READER_GONE: Final = (errno.EPIPE, errno.EIO)
"""What writing to a closed pipe and to a closed terminal fails with."""


class _LastingStream:
    """A stream that takes what is written to the end, whatever becomes of it: the work goes on.

    Attributes:
        failure: why what was written is not all there; None if it is, or if nobody reads any more, as after `head`.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.failure: OSError | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except OSError as error:
            self._lead_nowhere(error)
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError as error:
            self._lead_nowhere(error)

    def _lead_nowhere(self, error: OSError) -> None:
        """Discard what is written from now on, and what is in the buffer; tell of it, unless nobody reads."""
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)
        if error.errno not in _READER_GONE:
            self.failure = error
            sys.stderr.write(f"Error: {self._stream.name.strip('<>')} cannot be written: {error.strerror}\n")


@contextmanager
def lasting_output() -> Iterator[None]:
    """Have stdout and stderr lead nowhere, in place of raising, where they are closed or cannot be written.

    Raises:
        SystemExit: with 1 in place of 0 where not all of the output could be written.
    """
    sys.stdin = sys.stdin or _nowhere("r")
    streams = [_LastingStream(stream or _nowhere("w")) for stream in (sys.stdout, sys.stderr)]
    sys.stdout, sys.stderr = (cast("TextIO", stream) for stream in streams)
    try:
        yield
    except SystemExit as ended:
        for stream in streams:
            stream.flush()
        if any(stream.failure for stream in streams):
            raise SystemExit(ended.code or ExitCode.FAILED) from None
        raise


def _nowhere(mode: str) -> TextIO:
    return cast("TextIO", Path(os.devnull).open(mode, encoding="utf-8"))
