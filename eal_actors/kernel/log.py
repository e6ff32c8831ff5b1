"""Logging: one structlog configuration, whose lines name the robot, resource and call.

Terminals get coloured lines on stderr, programs get JSON lines. Python's own `logging` gets every line too, where a
program has set it up. A library must not write unasked, so without
`configure_logging` only warnings and errors are shown.

A resource's actor records its resource and call in its thread, so that every line written there, by the framework or
by a plugin, names them.
"""

from __future__ import annotations

import contextlib
import io
import logging
import os
import stat
import sys
import threading
from collections import deque
from collections.abc import Mapping
from contextvars import ContextVar
from types import MappingProxyType
from typing import Final, Literal, TextIO, cast

import structlog

from eal_actors.kernel.printable import printable
from eal_actors.kernel.unwinding import Uninterrupted

LogFormat = Literal["human", "json"]

_resource: ContextVar[Mapping[str, str]] = ContextVar("resource", default=MappingProxyType({}))
_call_id: ContextVar[int | None] = ContextVar("call id", default=None)
_LOGGER: Final = logging.getLogger("eal_actors")
_PATIENCE_S: Final = 0.05
"""Real seconds that a line is awaited, so that it usually stands before what the program prints next."""
_MOST_LINES: Final = 1000
"""Lines that wait for a stream; further ones are lost."""
_OWN_FIELDS: Final = frozenset({"event", "level", "timestamp", "exc_info"})
debug_enabled = False
"""Whether debug lines are shown: a check before costly messages. A variable, because every call reads it."""


def bind_resource(robot: str, resource: str) -> None:
    """Name the robot and resource in every line of this thread from now on."""
    _resource.set({"robot": robot, "resource": resource})


set_call: Final = _call_id.set
"""Name the call in every line of this thread from now on; None for no call. Every call does it, so it must be cheap."""


def _add_context(_: object, __: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
    thread = _resource.get()
    if event.get("robot", thread.get("robot")) != thread.get("robot"):
        return event  # about another robot, from a callback in this resource's thread
    for key, value in thread.items():
        event.setdefault(key, value)
    if (call_id := _call_id.get()) is not None:
        event.setdefault("call", call_id)
    return event


def _without_controls(_: object, __: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
    """Write out the control characters in texts of others, which a terminal would obey."""
    return {key: printable(value) if isinstance(value, str) else value for key, value in event.items()}


def _send_on(_: object, __: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
    """Give the line to Python's own `logging` too, as the logger `eal_actors`, if the program has handlers there."""
    level = logging.getLevelNamesMapping().get(str(event.get("level", "")).upper(), logging.ERROR)
    exc_info = event.get("exc_info")
    failure = sys.exc_info() if exc_info is True else exc_info
    with Uninterrupted():  # an actor that is abandoned here would take the lock of a handler with it
        if _LOGGER.isEnabledFor(level) and _LOGGER.hasHandlers():
            fields = {key: value for key, value in event.items() if key not in _OWN_FIELDS}
            words = "".join(f" {key}={value}" for key, value in fields.items())
            _LOGGER.log(level, "%s%s", event.get("event", ""), words, extra={"eal": fields}, exc_info=failure or None)
    return event


class _Stream:
    """A stream that is looked up at each line, whose failures are ignored, and for which nobody waits long.

    A log line must never stop a motor's actor because the terminal was closed, or a dead-man's switch because the
    terminal was paused with Ctrl-S or nobody reads the pipe. So a thread writes to such streams while there are lines,
    and each line is awaited for a moment only. It bypasses Python's buffer, whose lock would abort the program's end.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream
        self._parts: list[str] = []
        self._lock = threading.Lock()
        self._lines: deque[tuple[int, bytes, threading.Event]] = deque()
        self._is_stuck = self._is_writing = False

    def write(self, text: str) -> int:
        self._parts.append(text)  # structlog flushes each line, and holds a lock meanwhile
        return len(text)

    def flush(self) -> None:
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


def configure_logging(format: LogFormat = "human", level: str = "info", stream: TextIO | None = None) -> None:  # noqa: A002
    """Set the format and level of log lines.

    Args:
        format: `human` for coloured lines (plain where the stream is no terminal), `json` for one object a line.
        level: the lowest level shown: debug, info, warning or error.
        stream: the output; stderr if None.
    """
    global debug_enabled  # one process, one configuration
    lowest = logging.getLevelNamesMapping()[level.upper()]
    debug_enabled = lowest <= logging.DEBUG
    out = _Stream(stream)
    renderer: structlog.typing.Processor
    if format == "json":
        renderer = structlog.processors.JSONRenderer(default=str)
    else:
        renderer = structlog.dev.ConsoleRenderer(colors=out.isatty(), exception_formatter=structlog.dev.plain_traceback)
    shared: list[structlog.typing.Processor] = [
        _add_context,
        structlog.processors.add_log_level,
        _send_on,
        structlog.processors.TimeStamper(fmt="iso" if format == "json" else "%H:%M:%S"),
    ]
    shared.append(structlog.processors.format_exc_info if format == "json" else _without_controls)
    structlog.configure(
        processors=[*shared, renderer],
        wrapper_class=structlog.make_filtering_bound_logger(lowest),
        logger_factory=structlog.PrintLoggerFactory(cast("TextIO", out)),
        cache_logger_on_first_use=False,
    )
    logging.getLogger("pykka").setLevel(logging.CRITICAL)  # our actors report every failure that it would print


def get_logger(**bound: object) -> structlog.typing.FilteringBoundLogger:
    """Return a logger whose every line carries the given keys."""
    if not structlog.is_configured():
        configure_logging(level="warning")
    return cast("structlog.typing.FilteringBoundLogger", structlog.get_logger(**bound))
