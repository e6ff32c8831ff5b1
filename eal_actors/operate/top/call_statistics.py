"""Call statistics of the last seconds: calls per second, and latencies."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

WINDOW_S: Final = 10.0
"""The period of the statistics."""
_MOST: Final = 4096  # calls that are kept per robot, so that a flood does not fill the memory


@dataclass(frozen=True, slots=True)
class CallStatistics:
    """Statistics of one robot; the quantiles are None without calls."""

    calls_per_s: float
    p50_s: float | None
    p99_s: float | None


class RecentCalls:
    """The durations of each robot's latest calls. Thread: any."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._calls: dict[str, deque[tuple[float, float]]] = {}

    def add(self, robot: str, ended_s: float, duration_s: float) -> None:
        """Add a call."""
        with self._lock:
            self._calls.setdefault(robot, deque(maxlen=_MOST)).append((ended_s, duration_s))

    def statistics(self, robot: str, now_s: float) -> CallStatistics:
        """Return the statistics of a robot."""
        with self._lock:
            calls = self._calls.get(robot, ())
            recent = [(ended_s, duration_s) for ended_s, duration_s in calls if now_s - WINDOW_S < ended_s <= now_s]
            is_full = len(calls) == _MOST and len(recent) == _MOST
        if not recent:
            return CallStatistics(0.0, None, None)
        span_s = max(now_s - recent[0][0], 1e-3) if is_full else WINDOW_S  # in a flood, the kept calls span less
        durations = sorted(duration_s for _, duration_s in recent)
        return CallStatistics(len(recent) / span_s, quantile(durations, 0.5), quantile(durations, 0.99))


def quantile(ascending: Sequence[float], part: float) -> float:
    """Return a quantile over 0, up to 1, of at least one value in ascending order, by the nearest rank."""
    return ascending[max(0, math.ceil(part * len(ascending)) - 1)]
