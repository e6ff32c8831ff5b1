"""NonBlockingStream: output to a terminal, pipe or file that stops nobody.

A line must never stop a motor's actor because the terminal was closed, or a dead-man's switch because the terminal was
paused with Ctrl-S or nobody reads the pipe. So a thread writes to such streams while there are lines, and each line is
awaited for a moment only. It bypasses Python's buffer, whose lock would abort the program's end.
"""

from __future__ import annotations

import contextlib
import io
import os
import stat
import sys
import threading
from collections import deque
from typing import Final, TextIO

from eal_actors.kernel.unwinding import Uninterrupted

_PATIENCE_S: Final = 0.05
"""Real seconds that a line is awaited, so that it usually stands before what the program prints next."""
_MOST_LINES: Final = 1000
"""Lines that wait for a stream; further ones are lost."""


class NonBlockingStream:
    """A stream whose failures are ignored, and for which nobody waits long.

    Args:
        stream: the stream; None for stderr, which is looked up at each line.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream
        self._parts: list[str] = []
        self._lock = threading.Lock()
        self._lines: deque[tuple[int, bytes, threading.Event]] = deque()
        self._is_stuck = self._is_writing = False

    def write(self, text: str) -> int:
        """Add to the next lines; return the length. Thread: one at a time, as consoles and structlog ensure."""
        self._parts.append(text)
        return len(text)

    def flush(self) -> None:
        """Write the lines. Thread: as `write`; waits for a moment at most, unless the stream is a file."""
        text = "".join(self._parts)
        self._parts.clear()
        stream = self._stream or sys.stderr
        # Closed pipes and files raise, and there may be no stderr at all.
        with Uninterrupted(), contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
            if (number := _may_block(stream)) is None:
                stream.write(text)
                stream.flush()
            else:
                self._hand_over(number, text.encode(stream.encoding or "utf-8", "backslashreplace"))

    def _hand_over(self, number: int, line: bytes) -> None:
        is_written = threading.Event()
        with self._lock:
            if len(self._lines) >= _MOST_LINES:
                return
            self._lines.append((number, line, is_written))
            starts, self._is_writing = not self._is_writing, True
        if starts:
            try:
                threading.Thread(target=self._write, name="log", daemon=True).start()
            except RuntimeError:  # the interpreter ends
                self._write()
        self._is_stuck = not is_written.wait(0.0 if self._is_stuck else _PATIENCE_S)

    def _write(self) -> None:
        while True:
            with self._lock:
                if not self._lines:
                    self._is_writing = False
                    return
                number, line, is_written = self._lines.popleft()
            with contextlib.suppress(OSError):
                while line:
                    line = line[os.write(number, line) :]
            is_written.set()

    def isatty(self) -> bool:
        """Return whether the stream is a terminal."""
        stream = self._stream or sys.stderr
        return stream is not None and stream.isatty()


def _may_block(stream: TextIO) -> int | None:
    """Return the descriptor of a terminal, pipe or socket; None for a file, or where Python code shows the lines."""
    if isinstance(stream, io.TextIOBase) and not isinstance(stream, io.TextIOWrapper):  # such as rich's, above a table
        return None
    try:
        number = stream.fileno()
        mode = os.fstat(number).st_mode
    except (OSError, ValueError):
        return None
    return number if stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode) or os.isatty(number) else None
