"""A clock for tests: its time stands still until the test advances it."""

from __future__ import annotations

import heapq
import itertools
import threading
from collections.abc import Callable

from typing_extensions import override

from eal_actors.kernel.clock import Clock, release


class ManualClock(Clock):
    """A clock that a test advances; otherwise its time stands still.

    Waits without a release end only when `advance` passes their time. `advance` does not wait for the threads
    it wakes: a test waits for their effect (a future, an event).
    """

    def __init__(self, start_s: float = 0.0) -> None:
        self._now = start_s
        self._lock = threading.Lock()
        self._order = itertools.count()
        self._waits: list[tuple[float, int, threading.Lock, list[bool]]] = []

    @override
    def now(self) -> float:
        return self._now

    @override
    def wait(self, waiter: threading.Lock, timeout_s: float | None, serve: Callable[[], float] | None = None) -> bool:
        if timeout_s is None:
            return waiter.acquire()
        expired = [False]
        with self._lock:
            if timeout_s <= 0:
                return waiter.acquire(blocking=False)
            heapq.heappush(self._waits, (self._now + timeout_s, next(self._order), waiter, expired))
        waiter.acquire()
        return not expired[0]

    def advance(self, duration_s: float) -> None:
        """Move the clock forward and wake every wait whose time has come. Thread: any."""
        with self._lock:
            self._now += duration_s
            due = []
            while self._waits and self._waits[0][0] <= self._now:
                due.append(heapq.heappop(self._waits))
        for _, _, waiter, expired in due:
            expired[0] = True
            release(waiter)


class HurriedClock(ManualClock):
    """A clock on which who sleeps moves the time."""

    def sleep(self, duration_s: float) -> None:
        self.advance(duration_s)
