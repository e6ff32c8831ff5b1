"""Time for the whole framework: nothing else reads a clock or sleeps.

A fleet has one Clock. Sleeps, time-outs, deadlines, timers and simulated physics all follow it, so that the same
scenario runs in real time, faster, or step by step under a test's hand.

Every wait goes through `Clock.wait` on a *waiter*, a lock that is held until somebody releases it to wake the
one thread that waits. It is what `threading.Condition` is made of, and several times cheaper.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import threading
import time
from datetime import UTC, datetime
from typing import Final, Protocol


def new_waiter() -> threading.Lock:
    """Return a lock that is already held: `release()` wakes the thread that waits for it."""
    waiter = threading.Lock()
    waiter.acquire()
    return waiter


def wake(waiter: threading.Lock) -> None:
    """Wake the thread that waits on the waiter; harmless if it was woken already."""
    with contextlib.suppress(RuntimeError):  # already released: the wake-up is on its way
        waiter.release()


_MAIN_THREAD: Final = threading.main_thread().ident
_LOOK_UP_S: Final = 0.2
"""How often (real time) the main thread, where signals are handled, looks up from a wait."""


class Clock(Protocol):
    """What the framework needs to know of time. All durations are in seconds of this clock."""

    def now(self) -> float:
        """Return the seconds since the clock was made. Never goes backwards. Thread: any."""
        ...

    def wait(self, waiter: threading.Lock, timeout_s: float | None) -> bool:
        """Block until the waiter is released or the time-out passes.

        Args:
            waiter: a held lock, see `new_waiter`. It is held again when this returns True.
            timeout_s: seconds of this clock, or None for no limit.

        Returns:
            True if the waiter was released, False if the time passed. A waiter may be released without need:
            callers check again what they wait for.

        Thread: blocks the caller.
        """
        ...

    def sleep(self, duration_s: float) -> None:
        """Block the caller for a duration in seconds of this clock. Thread: blocks the caller."""
        ...


class ScaledClock:
    """A clock that runs at `rate` times real time.

    Args:
        rate: seconds of this clock in one real second, over 0; 1 is real time.
    """

    def __init__(self, rate: float = 1.0) -> None:
        if not rate > 0:
            raise ValueError(f"a clock's rate must be over 0, not {rate}")
        self.rate: Final = float(rate)
        self._start_s = time.monotonic()

    def now(self) -> float:
        """See Clock."""
        return (time.monotonic() - self._start_s) * self.rate

    def wait(self, waiter: threading.Lock, timeout_s: float | None) -> bool:
        """See Clock."""
        real_s = threading.TIMEOUT_MAX if timeout_s is None else max(timeout_s, 0.0) / self.rate
        if threading.get_ident() == _MAIN_THREAD:
            return self._wait_alert(waiter, real_s)
        return waiter.acquire(timeout=min(real_s, threading.TIMEOUT_MAX))

    @staticmethod
    def _wait_alert(waiter: threading.Lock, real_s: float) -> bool:
        """Wait, looking up for signals: one that comes on the brink of a wait is handled only after it."""
        end_s = time.monotonic() + real_s
        while True:
            left_s = end_s - time.monotonic()
            if left_s <= _LOOK_UP_S:
                return waiter.acquire(timeout=max(left_s, 0.0))
            if waiter.acquire(timeout=_LOOK_UP_S):
                return True

    def sleep(self, duration_s: float) -> None:
        """See Clock."""
        self.wait(new_waiter(), duration_s)


class SystemClock(ScaledClock):
    """Real time."""

    def __init__(self) -> None:
        super().__init__(1.0)


class ManualClock:
    """A clock that stands still until a test moves it.

    Waits without a release end only when `advance` passes their time. `advance` does not wait for the threads
    it wakes: a test waits for what they do (a future, an event).
    """

    def __init__(self, start_s: float = 0.0) -> None:
        self._now = start_s
        self._lock = threading.Lock()
        self._order = itertools.count()
        self._waits: list[tuple[float, int, threading.Lock, list[bool]]] = []

    def now(self) -> float:
        """See Clock."""
        return self._now

    def wait(self, waiter: threading.Lock, timeout_s: float | None) -> bool:
        """See Clock."""
        if timeout_s is None:
            return waiter.acquire()
        expired = [False]
        with self._lock:
            if timeout_s <= 0:
                return waiter.acquire(blocking=False)
            heapq.heappush(self._waits, (self._now + timeout_s, next(self._order), waiter, expired))
        waiter.acquire()
        return not expired[0]

    def sleep(self, duration_s: float) -> None:
        """See Clock."""
        self.wait(new_waiter(), duration_s)

    def advance(self, duration_s: float) -> None:
        """Move the clock forward and wake every wait whose time has come. Thread: any."""
        with self._lock:
            self._now += duration_s
            due = []
            while self._waits and self._waits[0][0] <= self._now:
                due.append(heapq.heappop(self._waits))
        for _, _, waiter, expired in due:
            expired[0] = True
            wake(waiter)


REAL_TIME: Final = SystemClock()
"""For what must happen in real time whatever the fleet's clock does: closing, joining threads."""


def wall_time() -> datetime:
    """Return the date and time of day, in UTC: for names of files and records, never for durations."""
    return datetime.now(UTC)
