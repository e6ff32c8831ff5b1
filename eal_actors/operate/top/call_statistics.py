"""CallStatistics of the last seconds: how many calls, and how long they took."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

WINDOW_S: Final = 10.0
"""Over how many seconds figures are taken."""
_MOST: Final = 4096
"""Calls that are kept of each robot: a flood must not fill the memory."""


@dataclass(frozen=True, slots=True)
class CallStatistics:
    """What the last seconds were like.

    Attributes:
        calls_per_s: how many calls ended in a second.
        p50_s: half of them took at most so long; None without calls.
        p99_s: 99 of 100 took at most so long; None without calls.
    """

    calls_per_s: float
    p50_s: float | None
    p99_s: float | None


class RecentCalls:
    """Keeps what the last seconds' calls of each robot took. Thread: any."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._taken: dict[str, deque[tuple[float, float]]] = {}

    def note(self, robot: str, at_s: float, took_s: float) -> None:
        """Note that a call of a robot ended at a time of the clock, and how long it took."""
        with self._lock:
            self._taken.setdefault(robot, deque(maxlen=_MOST)).append((at_s, took_s))

    def figures(self, robot: str, now_s: float) -> CallStatistics:
        """Return the figures of a robot."""
        with self._lock:
            taken = self._taken.get(robot, ())
            recent = [(at_s, took_s) for at_s, took_s in taken if now_s - WINDOW_S < at_s <= now_s]
            is_full = len(taken) == _MOST and len(recent) == _MOST
        if not recent:
            return CallStatistics(0.0, None, None)
        span_s = max(now_s - recent[0][0], 1e-3) if is_full else WINDOW_S  # of a flood, only the newest are known
        times = sorted(took_s for _, took_s in recent)
        return CallStatistics(len(recent) / span_s, quantile(times, 0.5), quantile(times, 0.99))


def quantile(ascending: Sequence[float], part: float) -> float:
    """Return the least of the values that is not exceeded by the given part of them (nearest rank).

    Args:
        ascending: at least one value, in ascending order.
        part: over 0, up to 1.
    """
    return ascending[max(0, math.ceil(part * len(ascending)) - 1)]
