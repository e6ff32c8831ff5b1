"""ThrottledLog: warnings of malformed messages, few of each source and few in all, so that no stranger fills a disk.

A period has one line for each of its first sources and one with the counts of the rest. The number of remembered
sources is limited too, since without security a sender can name a new source in each message.
"""

from __future__ import annotations

import threading
from collections import Counter
from typing import Final

from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.log import get_logger

PERIOD_S: Final = 60.0
"""Real seconds in which one source is reported once."""

_MAX_SOURCES: Final = 10
"""Sources that are reported within one period; without security a sender can name any source."""

_MAX_REASON: Final = 300


class ThrottledLog:
    """Logs at most one warning of each source within PERIOD_S, and counts the others. Thread: any."""

    def __init__(self, clock: Clock = REAL_TIME, **context: str) -> None:
        self._clock = clock
        self._log = get_logger(**context)
        self._lock = threading.Lock()
        self._period_end_s = 0.0
        self._seen: Counter[str] = Counter()
        self._others = 0

    def warn(self, source: str, message: str, reason: str) -> None:
        """Log a warning, unless its source or too many others were reported shortly before."""
        with self._lock:
            now_s = self._clock.now()
            if now_s >= self._period_end_s:
                self._report_rest()
                self._period_end_s = now_s + PERIOD_S
            is_new = source not in self._seen
            if is_new and len(self._seen) >= _MAX_SOURCES:
                self._others += 1
                return
            self._seen[source] += 1
        if is_new:
            self._log.warning(message, source=source[:_MAX_REASON], reason=reason[:_MAX_REASON])

    def _report_rest(self) -> None:
        """Log how many warnings the period that has ended left out."""
        repeated = {source[:_MAX_REASON]: count - 1 for source, count in self._seen.items() if count > 1}
        if repeated or self._others:
            self._log.warning("further warnings were not logged", by_source=repeated, other_sources=self._others)
        self._seen.clear()
        self._others = 0
