"""Brings log lines to the page, beside wherever else they go."""

from __future__ import annotations

import logging
from collections.abc import Callable
from types import TracebackType
from typing import Any, Final, Self

import structlog

from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.log import get_logger
from eal_actors.operate.dashboard.doings import Doings
from eal_actors.operate.dashboard.hub import Hub

LEAST_LEVEL: Final = logging.INFO
"""What the page gets, however little the terminal shows."""
_OWN_KEYS: Final = frozenset({"event", "level", "timestamp", "robot", "resource", "exc_info", "exception"})
_MOST_CHARACTERS: Final = 2000


class LogTap:
    """Copies log lines to the hub, between `with` and its end.

    Lines below the level of the terminal come to the page alone.

    Args:
        hub: where lines go.
        doings: where errors of robots are noted.
    """

    def __init__(self, hub: Hub, doings: Doings) -> None:
        self._hub = hub
        self._doings = doings
        self._before: dict[str, Any] = {}
        self._terminal_level = LEAST_LEVEL

    def __enter__(self) -> Self:
        logger = get_logger()  # which configures logging, should nobody have done so yet
        self._terminal_level = logger.get_effective_level()
        self._before = structlog.get_config()
        *shared, renderer = self._before["processors"]
        structlog.configure(
            processors=[*shared, self._copy, renderer],
            wrapper_class=structlog.make_filtering_bound_logger(min(LEAST_LEVEL, self._terminal_level)),
        )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        structlog.configure(**self._before)

    def _copy(self, _: object, method: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
        level = str(event.get("level", method))
        robot = event.get("robot")
        text = _short(event.get("event", ""))
        details = {key: _short(value) for key, value in event.items() if key not in _OWN_KEYS}
        self._hub.tell(
            "logs",
            {
                "at": wall_time().isoformat(timespec="milliseconds"),
                "level": level,
                "robot": robot,
                "resource": event.get("resource"),
                "text": text,
                "details": details,
            },
        )
        if isinstance(robot, str) and level in ("error", "critical"):
            reason = details.get("reason") or details.get("error")
            self._doings.fail(robot, f"{text}: {reason}" if reason else text)
        if logging.getLevelNamesMapping().get(level.upper(), logging.ERROR) < self._terminal_level:
            raise structlog.DropEvent
        return event


def _short(value: object) -> str:
    text: Callable[[object], str] = str
    try:
        shown = text(value)
    except Exception:  # noqa: BLE001  # a value's own __str__ may do anything, and a log line must not
        return type(value).__name__
    return shown if len(shown) <= _MOST_CHARACTERS else f"{shown[:_MOST_CHARACTERS]}..."
