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
from collections.abc import Iterator
from contextlib import AbstractContextManager
from datetime import UTC, datetime
from typing import Final, Protocol

from eal_actors.kernel.errors import CallCancelledError


def new_waiter() -> threading.Lock:
    """Return a lock that is already held: `Clock.wake` wakes the thread that waits for it."""
    waiter = threading.Lock()
    waiter.acquire()
    return waiter


_MAIN_THREAD: Final = threading.main_thread().ident
_LOOK_UP_S: Final = 0.2
"""How often (real time) the main thread, where signals are handled, looks up from a wait."""


def release(lock: threading.Lock) -> None:
    """Release a lock, of which any number of threads may believe that it is still held. For clocks alone."""
    try:
        lock.release()
    except RuntimeError:  # already released; contextlib.suppress costs several times as much, in every wake-up
        return


def acquire_alert(lock: threading.Lock, real_s: float) -> bool:
    """Acquire a lock within real seconds; a main thread stays alert to signals meanwhile. For clocks alone."""
    if threading.get_ident() != _MAIN_THREAD:
        return lock.acquire(timeout=min(real_s, threading.TIMEOUT_MAX))
    end_s = time.monotonic() + real_s
    while True:  # a signal that comes on the brink of a wait is handled only after it
        left_s = end_s - time.monotonic()
        if left_s <= _LOOK_UP_S:
            return lock.acquire(timeout=max(left_s, 0.0))
        if lock.acquire(timeout=_LOOK_UP_S):
            return True


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

    def wake(self, waiter: threading.Lock) -> None:
        """Release the waiter: wake the thread that waits on it; harmless if it was woken already. Thread: any."""
        ...

    def sleep(self, duration_s: float) -> None:
        """Block the caller for a duration in seconds of this clock.

        Raises:
            CallCancelledError: the caller's task was cancelled.

        Thread: blocks the caller.
        """
        ...

    def of_real(self, duration_s: float) -> float:
        """Return how many seconds of this clock a time-out of so many real seconds is. Thread: any."""
        ...

    def start(self, thread: threading.Thread) -> None:
        """Start a thread that lives by this clock. Thread: any."""
        ...

    def outside(self) -> AbstractContextManager[None]:
        """Return a context in which the thread may wait for what no clock knows of, such as the end of a thread."""
        ...


class CancelScope:
    """Interrupts what one thread waits for (compare trio.CancelScope).

    A cancelled scope stays cancelled: the wait under way and every later one raise CallCancelledError, so a function
    that catches the error once cannot keep its thread waiting. It covers the waits of users (`Future.get`, a stream,
    `Clock.sleep`, `wait_in_scope`). Actors wait on their clock directly, so that no scope can interrupt one.

    Args:
        parent: the scope that cancels this one with itself; None if there is none.
    """

    def __init__(self, parent: CancelScope | None = None) -> None:
        self._lock = threading.RLock()  # a signal handler may cancel while its own thread holds the lock
        self._parent = parent
        self._children: list[CancelScope] = []
        self._waiting: tuple[Clock, threading.Lock] | None = None
        self.is_cancelled = False
        if parent is not None:
            parent.add_child(self)

    def add_child(self, child: CancelScope) -> None:
        """Cancel another scope with this one, at once if this one is cancelled. Thread: any."""
        with self._lock:
            self._children.append(child)
            child.is_cancelled = self.is_cancelled

    def remove_child(self, child: CancelScope) -> None:
        """Undo `add_child`. Thread: any."""
        with self._lock:
            self._children.remove(child)

    def cancel(self) -> None:
        """Interrupt the thread's waits from now on, and those of the scopes below. Thread: any; does not block."""
        with self._lock:
            self.is_cancelled = True
            waiting, children = self._waiting, list(self._children)
        if waiting is not None:
            clock, waiter = waiting
            clock.wake(waiter)
        for child in children:
            child.cancel()

    def close(self) -> None:
        """Leave the parent. Thread: any."""
        if self._parent is not None:
            self._parent.remove_child(self)

    def wait(self, clock: Clock, waiter: threading.Lock, timeout_s: float | None) -> bool:
        """Wait as `Clock.wait` does.

        Raises:
            CallCancelledError: the scope is cancelled.

        Thread: blocks the caller, which is the scope's one thread.
        """
        with self._lock:
            self._waiting = clock, waiter
        try:
            woken = not self.is_cancelled and clock.wait(waiter, timeout_s)
        finally:
            self._waiting = None
        if self.is_cancelled:
            raise CallCancelledError("the task was cancelled")
        return woken


_local = threading.local()


def current_scope() -> CancelScope | None:
    """Return the scope that the calling thread is in; None if it is in none."""
    return getattr(_local, "scope", None)


@contextlib.contextmanager
def in_scope(scope: CancelScope | None) -> Iterator[None]:
    """Let a scope interrupt the calling thread's waits in a `with` block; None shields them from every scope."""
    outer = current_scope()
    _local.scope = scope
    try:
        yield
    finally:
        _local.scope = outer


def wait_in_scope(clock: Clock, waiter: threading.Lock, timeout_s: float | None) -> bool:
    """Wait as `Clock.wait` does, until the calling thread's scope is cancelled.

    Raises:
        CallCancelledError: the scope is cancelled.

    Thread: blocks the caller.
    """
    scope = current_scope()
    return clock.wait(waiter, timeout_s) if scope is None else scope.wait(clock, waiter, timeout_s)


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
        return acquire_alert(waiter, real_s)

    def wake(self, waiter: threading.Lock) -> None:
        """See Clock."""
        release(waiter)

    def sleep(self, duration_s: float) -> None:
        """See Clock."""
        wait_in_scope(self, new_waiter(), duration_s)

    def of_real(self, duration_s: float) -> float:
        """See Clock."""
        return duration_s * self.rate

    def start(self, thread: threading.Thread) -> None:
        """See Clock."""
        thread.start()

    def outside(self) -> AbstractContextManager[None]:
        """See Clock: this clock does not mind."""
        return contextlib.nullcontext()


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

    def wake(self, waiter: threading.Lock) -> None:
        """See Clock."""
        release(waiter)

    def sleep(self, duration_s: float) -> None:
        """See Clock."""
        wait_in_scope(self, new_waiter(), duration_s)

    def of_real(self, duration_s: float) -> float:
        """See Clock."""
        return duration_s

    def start(self, thread: threading.Thread) -> None:
        """See Clock."""
        thread.start()

    def outside(self) -> AbstractContextManager[None]:
        """See Clock: this clock does not mind."""
        return contextlib.nullcontext()

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


REAL_TIME: Final = SystemClock()
"""For what must happen in real time whatever the fleet's clock does: closing, joining threads."""


def wall_time() -> datetime:
    """Return the date and time of day, in UTC: for names of files and records, never for durations."""
    return datetime.now(UTC)
