"""Logging: one structlog configuration, whose lines name the robot, resource and call.

Terminals get coloured lines on stderr, programs get JSON lines. Python's own `logging` gets every line too, where a
program has set it up. A library must not write unasked, so without
`configure_logging` only warnings and errors are shown.

A resource's actor records its resource and call in its thread, so that every line written there, by the framework or
by a plugin, names them.
"""

from __future__ import annotations

import io
import logging
import os
import sys
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from functools import partial
from types import MappingProxyType
from typing import Final, Literal, TextIO, cast

import structlog

from eal_actors.kernel.non_blocking_stream import NonBlockingStream
from eal_actors.kernel.printable import printable
from eal_actors.kernel.unwinding import Uninterrupted

LogFormat = Literal["human", "json"]

_resource: ContextVar[Mapping[str, str]] = ContextVar("resource", default=MappingProxyType({}))
_call_id: ContextVar[int | None] = ContextVar("call id", default=None)
_LOGGER: Final = logging.getLogger("eal_actors")
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


def _write_traceback(stream: TextIO, exc_info: structlog.typing.ExcInfo) -> None:
    """Write a traceback; its last line may be a text of others too."""
    text = io.StringIO()
    structlog.dev.plain_traceback(text, exc_info)
    stream.write(printable(text.getvalue()))


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


def configure_logging(format: LogFormat = "human", level: str = "info", stream: TextIO | None = None) -> None:  # noqa: A002
    """Set the format and level of log lines.

    Args:
        format: `human` for coloured lines (plain where the stream is no terminal), `json` for one object a line.
        level: the lowest level shown: debug, info, warning or error.
        stream: the output; stderr if None.
    """
    global debug_enabled, _configured  # one process, one configuration
    lowest = logging.getLevelNamesMapping()[level.upper()]
    debug_enabled = lowest <= logging.DEBUG
    out = NonBlockingStream(stream)
    renderer: structlog.typing.Processor
    if format == "json":
        renderer = structlog.processors.JSONRenderer(default=str)
    else:
        renderer = structlog.dev.ConsoleRenderer(colors=out.isatty(), exception_formatter=_write_traceback)
    shared: list[structlog.typing.Processor] = [
        _add_context,
        structlog.processors.add_log_level,
        _send_on,
        structlog.processors.TimeStamper(fmt="iso" if format == "json" else "%H:%M:%S"),
    ]
    shared.append(structlog.processors.format_exc_info if format == "json" else _without_controls)
    factory = structlog.PrintLoggerFactory(cast("TextIO", out))
    structlog.configure(
        processors=[*shared, renderer],
        wrapper_class=structlog.make_filtering_bound_logger(lowest),
        logger_factory=factory,
        cache_logger_on_first_use=False,
    )
    _configured = factory, partial(configure_logging, format, level, stream)
    logging.getLogger("pykka").setLevel(logging.CRITICAL)  # our actors report every failure that it would print


_configured: tuple[object, Callable[[], None]] = None, lambda: None


def _configure_child() -> None:
    factory, configure = _configured
    if structlog.get_config()["logger_factory"] is factory:
        configure()


if hasattr(os, "register_at_fork"):  # a child lacks the threads that hold the stream's lock, and write its lines
    os.register_at_fork(after_in_child=_configure_child)


def get_logger(**bound: object) -> structlog.typing.FilteringBoundLogger:
    """Return a logger whose every line carries the given keys."""
    if not structlog.is_configured():
        configure_logging(level="warning")
    return cast("structlog.typing.FilteringBoundLogger", structlog.get_logger(**bound))
