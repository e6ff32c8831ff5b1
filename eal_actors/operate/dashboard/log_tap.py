"""LogTap: copies log lines to the page."""

from __future__ import annotations

import logging
from typing import Any, Final, Self

import structlog

from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.log import get_logger
from eal_actors.operate.dashboard.state_store import CurrentSteps, StateStore

LEAST_LEVEL: Final = logging.INFO
"""The page's level, whatever the level of the terminal."""
_OWN_KEYS: Final = frozenset({"event", "level", "timestamp", "robot", "resource", "exc_info", "exception"})
_MOST_CHARACTERS: Final = 2000


class LogTap:
    """Copies log lines to a store, between `with` and its end.

    Lines below the level of the terminal go to the page only. Errors of robots are also recorded in `steps`. A program
    enters it before it connects its fleet, so that the page shows why a robot did not start.
    """

    def __init__(self) -> None:
        self.store: Final = StateStore()
        self.steps: Final = CurrentSteps()
        self._before: dict[str, Any] = {}
        self._terminal_level = LEAST_LEVEL

    def __enter__(self) -> Self:
        logger = get_logger()  # configures logging unless that has been done
        self._terminal_level = logger.get_effective_level()
        self._before = structlog.get_config()
        *shared, renderer = self._before["processors"]
        structlog.configure(
            processors=[*shared, self._copy, renderer],
            wrapper_class=structlog.make_filtering_bound_logger(min(LEAST_LEVEL, self._terminal_level)),
        )
        return self

    def __exit__(self, *_: object) -> None:
        structlog.configure(**self._before)

    def _copy(self, _: object, method: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
        level = str(event.get("level", method))
        robot = event.get("robot")
        text = _to_text(event.get("event", ""))
        details = {key: _to_text(value) for key, value in event.items() if key not in _OWN_KEYS}
        about = {"level": level, "robot": robot, "resource": event.get("resource"), "text": text, "details": details}
        self.store.append("logs", {"at": wall_time().isoformat(timespec="milliseconds"), **about})
        if isinstance(robot, str) and level in ("error", "critical"):
            reason = details.get("reason") or details.get("error")
            self.steps.record_error(robot, f"{text}: {reason}" if reason else text)
        if logging.getLevelNamesMapping().get(level.upper(), logging.ERROR) < self._terminal_level:
            raise structlog.DropEvent
        return event


def _to_text(value: object) -> str:
    try:
        text = str(value)
    except Exception:  # noqa: BLE001  # a value's __str__ may raise anything, but a log call must not
        return type(value).__name__
    return text if len(text) <= _MOST_CHARACTERS else f"{text[:_MOST_CHARACTERS]}..."
