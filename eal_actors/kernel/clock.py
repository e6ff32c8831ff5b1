"""Clocks and timers: no other code reads the time or sleeps.

A fleet has one Clock. Sleeps, time-outs, deadlines, timers and simulated physics all follow it, so that the same
scenario runs in real time, faster, or step by step in a test.

Every wait goes through `Clock.wait` on a *waiter*, a lock that is held until another thread releases it to wake the
one thread that waits. `threading.Condition` is built from the same, and is several times slower.
"""

from __future__ import annotations

import contextlib
import heapq
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from datetime import UTC, datetime
from typing import Final, Generic, TypeVar

from typing_extensions import override

from eal_actors.kernel.errors import CallCancelledError

_MAIN_THREAD: Final = threading.main_thread().ident
_SIGNAL_CHECK_S: Final = 0.2  # the main thread, which handles signals, interrupts its waits this often (real time)

ROUNDING_S: Final = 1e-9
"""A timer is due this early: now + (time - now) is not always time."""

_SWEEP_AT: Final = 1024


def new_waiter() -> threading.Lock:
    """Return a lock that is already held: `Clock.wake` wakes the thread that waits for it."""
    waiter = threading.Lock()
    waiter.acquire()
    return waiter


def release(lock: threading.Lock) -> None:
    """Release a lock, which another thread may have released already. For clocks alone."""
    try:
        lock.release()
    except RuntimeError:  # released already; contextlib.suppress costs several times as much, in every wake-up
        return


def acquire_alert(lock: threading.Lock, real_s: float) -> bool:
    """Acquire a lock within real seconds; the main thread still handles signals meanwhile. For clocks alone."""
    if threading.get_ident() != _MAIN_THREAD:
        return lock.acquire(timeout=min(real_s, threading.TIMEOUT_MAX))
    end_s = time.monotonic() + real_s
    while real_s > _SIGNAL_CHECK_S:  # a signal just before a wait begins would be handled only after it
        if lock.acquire(timeout=_SIGNAL_CHECK_S):
            return True
        real_s = end_s - time.monotonic()
    return lock.acquire(timeout=max(real_s, 0.0))


class Clock(ABC):
    """The time of a fleet. All durations are in seconds of this clock."""

    @abstractmethod
    def now(self) -> float:
        """Return the seconds since the clock was made. Never goes backwards. Thread: any."""

    @abstractmethod
    def wait(self, waiter: threading.Lock, timeout_s: float | None, serve: Callable[[], float] | None = None) -> bool:
        """Block until the waiter is released or the time-out passes.

        Args:
            waiter: a held lock, see `new_waiter`. It is held again when this returns True.
            timeout_s: seconds of this clock, or None for no limit.
            serve: does what the caller would do after the time-out, and returns the time of the next one, infinity for
                none. The clock may call it in another thread that waits with a `serve` of its own, and let the caller
                wait on. It must not wait.

        Returns:
            True if the waiter was released, False if the time passed. A waiter may be released without need:
            callers check their condition again.

        Thread: blocks the caller.
        """

    def wake(self, waiter: threading.Lock) -> None:
        """Release the waiter: wake the thread that waits on it; harmless if it was woken already. Thread: any."""
        try:  # as `release`, in every wake-up
            waiter.release()
        except RuntimeError:
            return

    def spares_turn(self, *, among_many: bool = False) -> bool:
        """Return whether the caller should do the work of a waiting thread itself, rather than wake it. Thread: any.

        With `among_many` the caller needs many threads at once, so that waking them would cost more than their work.
        """
        return among_many

    def sleep(self, duration_s: float) -> None:
        """Block the caller for a duration in seconds of this clock.

        Raises CallCancelledError if the caller's task was cancelled. Thread: blocks the caller.
        """
        wait_in_scope(self, new_waiter(), duration_s)

    def of_real(self, duration_s: float) -> float:
        """Return a time-out of so many real seconds in seconds of this clock. Thread: any."""
        return duration_s

    def to_real(self, time_s: float) -> float:
        """Return the real time (REAL_TIME) of a time of this clock. Thread: any."""
        return REAL_TIME.now() + (time_s - self.now()) / self.of_real(1.0)

    def from_real(self, real_s: float) -> float:
        """Return the time of this clock at a real time (REAL_TIME). Thread: any."""
        return self.now() + self.of_real(real_s - REAL_TIME.now())

    def start(self, thread: threading.Thread) -> None:
        """Start a thread that follows this clock. Thread: any."""
        thread.start()

    def outside(self) -> AbstractContextManager[None]:
        """Return a context in which the thread may wait for something other than the clock, such as a thread's end."""
        return contextlib.nullcontext()


class CancelScope:
    """Interrupts what one thread waits for (compare trio.CancelScope).

    A cancelled scope stays cancelled: the wait under way and every later one raise CallCancelledError, so a function
    that catches the error once cannot keep its thread waiting. It covers the waits of users (`Future.get`, a stream,
    `Clock.sleep`, `wait_in_scope`). Actors wait on their clock directly, so that no scope can interrupt one. A parent
    cancels it with itself.
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
        """Wait as `Clock.wait` does; CallCancelledError if the scope is cancelled.

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


class _ThreadLocal(threading.local):
    scope: CancelScope | None = None  # a default of getattr instead would cost each wait an AttributeError


_local: Final = _ThreadLocal()


def current_scope() -> CancelScope | None:
    """Return the scope that the calling thread is in; None if it is in none."""
    return _local.scope


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

    Raises CallCancelledError if the scope is cancelled. Thread: blocks the caller.
    """
    scope = _local.scope  # not current_scope(): every wait of a caller is here
    return clock.wait(waiter, timeout_s) if scope is None else scope.wait(clock, waiter, timeout_s)


class ScaledClock(Clock):
    """A clock that runs at `rate` times real time. `start_s` is the system's monotonic time at which it was made."""

    def __init__(self, rate: float = 1.0) -> None:
        if not rate > 0:
            raise ValueError(f"a clock's rate must be over 0, not {rate}")
        self.rate: Final = float(rate)
        self.start_s: Final = time.monotonic()

    @override
    def now(self) -> float:
        return (time.monotonic() - self.start_s) * self.rate

    @override
    def wait(self, waiter: threading.Lock, timeout_s: float | None, serve: Callable[[], float] | None = None) -> bool:
        if timeout_s is None:
            return acquire_alert(waiter, threading.TIMEOUT_MAX)
        return acquire_alert(waiter, timeout_s / self.rate if timeout_s > 0 else 0.0)

    @override
    def of_real(self, duration_s: float) -> float:
        return duration_s * self.rate

    @override
    def to_real(self, time_s: float) -> float:
        return time_s / self.rate + self.start_s - REAL_TIME.start_s

    @override
    def from_real(self, real_s: float) -> float:
        return (real_s + REAL_TIME.start_s - self.start_s) * self.rate


class SystemClock(ScaledClock):
    """Real time."""

    def __init__(self) -> None:
        super().__init__(1.0)

    @override
    def now(self) -> float:
        return time.monotonic() - self.start_s


class _RealTime(SystemClock):
    """The system's monotonic time itself, which needs no function of ours: each remote call reads it several times."""

    def __init__(self) -> None:
        super().__init__()
        self.start_s = 0.0  # type: ignore[misc]  # final in all other clocks
        self.now = time.monotonic  # type: ignore[method-assign]


REAL_TIME: Final[SystemClock] = _RealTime()
"""The clock for waits that must take real time whatever the fleet's clock does: closing, joining threads."""


def wall_time() -> datetime:
    """Return the date and time of day, in UTC: for names of files and records, never for durations."""
    return datetime.now(UTC)


class Timer:
    """An action with a time.

    Of two timers of one time, the one with the lower `order` goes first. `time_s` is in seconds of a clock. `action` is
    None once it has run or is cancelled.
    """

    __slots__ = ("action", "order", "time_s")

    def __init__(self, time_s: float, order: int, action: Callable[[], object]) -> None:
        self.time_s = time_s
        self.order = order
        self.action: Callable[[], object] | None = action

    def cancel(self) -> None:
        """Cancel it; harmless when it has run. Thread: any, because it is one assignment."""
        self.action = None


R = TypeVar("R", bound=Timer)


class TimerHeap(Generic[R]):
    """Timers in the order of their times. Cancelled ones are removed now and then.

    `heap` has the timers with their times and orders, cancelled ones among them. Thread: its owner locks it.
    """

    def __init__(self) -> None:
        self.heap: list[tuple[float, int, R]] = []
        self._sweep_at = _SWEEP_AT

    def __len__(self) -> int:
        return len(self.heap)

    def add(self, timer: R) -> None:
        """Add a timer."""
        heapq.heappush(self.heap, (timer.time_s, timer.order, timer))
        if len(self.heap) > self._sweep_at:
            self.heap = [entry for entry in self.heap if entry[2].action is not None]
            heapq.heapify(self.heap)
            self._sweep_at = max(_SWEEP_AT, 2 * len(self.heap))

    def first(self) -> R | None:
        """Return the next timer, or None."""
        while self.heap and self.heap[0][2].action is None:
            heapq.heappop(self.heap)
        return self.heap[0][2] if self.heap else None

    def pop(self) -> R:
        """Remove the timer that `first` returned."""
        return heapq.heappop(self.heap)[2]

    def clear(self) -> None:
        """Remove all timers."""
        self.heap.clear()
