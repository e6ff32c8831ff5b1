"""A clock that jumps: as fast as the machine can go, and the same on every run.

Of the threads that count, one at a time has *the turn* and keeps it until it waits. Then the next thread that was woken
gets it, in the order of the wake-ups; if none was, all wait for time, and time jumps to the earliest end of a wait. So
the threads run one after the other in an order that depends only on what they do, however busy the machine is: a run
is repeatable.

A thread that would do no more than run its timers need not wake up for that: the thread that gives up the turn may
run them in its place, if it may run code of that kind (`serve` of `Clock.wait`). The order is the same. Among thousands
of threads a switch costs many times what a timer does.

Where threads keep one another busy forever, such as one that polls a value until it changes, time advances by a tick
after a number of turns, so such a loop ends, if later than one that sleeps between two polls. A tick does not end a
wait that began after the tick before: it may be for the answer to the poll itself.

A thread counts as soon as it waits on the clock, or was started by `LockStepClock.start`. A thread that has the turn
and waits for something else (a socket, a key, another thread) would block all others. A watchdog detects it, takes the
turn away and logs a warning; the thread counts again as soon as it waits on the clock. Its actions are not repeatable.
`outside` is for code that knows beforehand that it waits for something else.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import ClassVar, Final, Literal, TypeAlias

from typing_extensions import override

from eal_actors.kernel.clock import Clock, ScaledClock, Timer, TimerHeap, acquire_alert, new_waiter, release
from eal_actors.kernel.log import get_logger

MAX: Final = "max"
"""The rate of a clock as fast as the machine."""

Rate: TypeAlias = float | Literal["max"]
"""Seconds of a clock in one real second, or MAX."""

_CHECK_S: Final = 0.25
_IDLE_CHECKS: Final = 2
_IDLE_CHECKS_WHILE_OTHERS_WORK: Final = 20
_IDLE_S: Final = 0.001
"""A thread that has the turn waits for something if it sleeps at this many checks in a row and uses less processor time
than this in between (one that wakes up now and then to poll uses more). Other threads of the process that work
meanwhile, or want a processor, may work for it, as those of OpenCV do: then it takes more checks."""
_OTHERS_WORK: Final = 0.2  # the least share of the time that a working process uses

_PATIENCE_S: Final = 30.0
"""Processor time that the process may use in one turn before time advances without the thread that has it."""

_TURNS_AT_ONCE: Final = 100
_TURNS_AT_ONCE_EACH: Final = 10
"""The most turns while time stands still: a constant, and more for each thread that waits."""
_TICK_S: Final = 0.1  # the longest tick


class _Wait(Timer):
    """One thread's wait: for a waiter, for a time, or only for the turn.

    Attributes:
        waiter: the lock it waits on; None where it only waits for the turn.
        go: held until the thread has the turn.
        serve: runs what the thread would do after the time-out; see `Clock.wait`.
        was_released: True if the waiter was released, False if the time passed.
        is_over: the thread has the turn, or has given up waiting.
    """

    __slots__ = ("go", "is_over", "serve", "thread", "waiter", "was_released")

    def __init__(
        self,
        thread: threading.Thread,
        waiter: threading.Lock | None = None,
        time_s: float = 0.0,
        order: int = 0,
        serve: Callable[[], float] | None = None,
    ) -> None:
        super().__init__(time_s, order, _do_nothing)
        self.thread = thread
        self.waiter = waiter
        self.serve = serve
        self.go = new_waiter()
        self.was_released = False
        self.is_over = False


def _do_nothing() -> None:
    """Do nothing: the action of a wait, which as a live timer must have one."""


class LockStepClock(Clock):
    """A clock that advances only when all threads wait; see the module."""

    rate: Final = MAX

    def __init__(self) -> None:
        self._now = 0.0
        self._lock = threading.RLock()  # a signal's handler may wake somebody while its thread holds the lock
        self._order = itertools.count()
        self._running: threading.Thread | None = None
        self._turns = 0
        self._ticked_at = 0
        self._ticked_order = 0
        self._ready: deque[_Wait] = deque()
        self._waits: dict[threading.Lock, _Wait] = {}
        self._timed: TimerHeap[_Wait] = TimerHeap()
        self._watchdog: threading.Lock | None = None

    _in_step: ClassVar[set[threading.Thread]] = set()  # the threads that wait for their turn, on any clock

    @override
    def now(self) -> float:
        return self._now

    @override
    def wait(self, waiter: threading.Lock, timeout_s: float | None, serve: Callable[[], float] | None = None) -> bool:
        """Wait as `Clock` says; with a time-out of 0, the threads that are ready go first."""
        time_s = self._now + (timeout_s or 0.0)
        wait = _Wait(threading.current_thread(), waiter, time_s, next(self._order), serve)
        with self._lock:
            self._waits[waiter] = wait  # before the waiter is checked, or a signal's release in between would be lost
            if waiter.acquire(blocking=False):
                self._end(wait)
                return True
            if timeout_s is not None and timeout_s <= 0:
                self._ready.append(wait)
            elif timeout_s is not None:
                self._timed.add(wait)
            served = self._hand_over(server=wait)
        while served is not None:
            self._serve(served, wait)
            with self._lock:
                served = self._hand_over(server=wait)
        self._await_turn(wait)
        return wait.was_released

    def _serve(self, wait: _Wait, server: _Wait) -> None:
        """Run what another thread would do now, and let that thread wait on. Thread: the server's, with the turn."""
        next_s = self._now
        try:
            next_s = wait.serve() if wait.serve is not None else next_s
        except BaseException:
            with self._lock:
                self._end(server)
            raise
        finally:
            with self._lock:
                if not wait.is_over and not wait.was_released:
                    wait.time_s, wait.order, wait.action = next_s, next(self._order), _do_nothing
                    if next_s < math.inf:
                        self._timed.add(wait)

    @override
    def wake(self, waiter: threading.Lock) -> None:
        with self._lock:
            if (wait := self._waits.pop(waiter, None)) is None:
                release(waiter)
                return
            wait.was_released = True
            wait.cancel()
            self._ready.append(wait)
            self._dispatch_if_free()

    @override
    def spares_turn(self, *, among_many: bool = False) -> bool:
        """Return whether the caller has the turn, so that the threads that it would wake could only wait for it.

        Work without a turn counts as a turn: a thread that polls must not keep time from advancing.
        """
        if self._running is not threading.current_thread() or self._is_spinning():
            return False
        self._turns += 1
        return True

    @override
    def start(self, thread: threading.Thread) -> None:
        wait, run = _Wait(thread), thread.run

        def run_in_turn() -> None:
            self._await_turn(wait)
            try:
                run()
            finally:
                with self._lock:
                    self._hand_over()

        thread.run = run_in_turn  # type: ignore[method-assign]  # its target stays in place
        with self._lock:
            self._ready.append(wait)
        thread.start()
        with self._lock:
            self._dispatch_if_free()

    @override
    @contextlib.contextmanager
    def outside(self) -> Iterator[None]:
        me = threading.current_thread()
        with self._lock:
            has_turn = self._running is me
            if has_turn:
                self._hand_over()
        try:
            yield
        finally:
            if has_turn and self._running is not me:  # a wait on the clock has given the turn back already
                wait = _Wait(me)
                with self._lock:
                    self._ready.append(wait)
                    self._dispatch_if_free()
                self._await_turn(wait)

    # The turn. Its steps are in an order that lets Ctrl-C strike between any two.

    def _hand_over(self, server: _Wait | None = None) -> _Wait | None:
        """Give the turn to the next thread if the caller or no thread has it. Thread: holds the lock.

        `server` is the wait of a caller that may run what others would do. Return a wait that it is to serve, with the
        turn; None if there is none.
        """
        if self._running is threading.current_thread():
            self._running = None
        return self._dispatch_if_free(server)

    def _dispatch_if_free(self, server: _Wait | None = None) -> _Wait | None:
        """Give the turn to the next thread if no thread has it; see `_hand_over`. Thread: holds the lock."""
        if self._running is None and (wait := self._next()) is not None:
            self._turns += 1
            is_ready = bool(self._ready) and self._ready[0] is wait
            if server is not None and server.serve and wait.serve and wait is not server and not is_ready:
                self._running = server.thread
                self._timed.pop()
                return wait
            release(wait.go)
            self._running = wait.thread
            self._end(wait)
            if is_ready:
                self._ready.popleft()
        self._adjust_watchdog()
        return None

    def _next(self) -> _Wait | None:
        """Return the wait that ends next; time jumps to its end if that is ahead. Thread: holds the lock."""
        while self._ready and self._ready[0].is_over:
            self._ready.popleft()
        wait = self._timed.first()
        if self._ready and (wait is None or not self._is_spinning()):
            return self._ready[0]
        if wait is None:
            return None
        step_s = left_s = max(wait.time_s - self._now, 0.0)
        if self._ready:
            step_s = min(left_s / 2 if wait.order > self._ticked_order else left_s, _TICK_S)
        self._ticked_at, self._ticked_order = self._turns, next(self._order)
        if step_s < left_s:
            self._now += step_s
            return self._ready[0]
        self._now = max(self._now, wait.time_s)
        return wait

    def _is_spinning(self) -> bool:
        """Return whether threads keep one another busy, such as by polling a value.

        On a running clock that would take time, so time advances as if it had.
        """
        return self._turns - self._ticked_at > _TURNS_AT_ONCE + _TURNS_AT_ONCE_EACH * len(self._waits)

    def _end(self, wait: _Wait) -> None:
        wait.is_over = True
        wait.cancel()
        if wait.waiter is not None and self._waits.get(wait.waiter) is wait:
            del self._waits[wait.waiter]

    def _await_turn(self, wait: _Wait) -> None:
        try:
            self._in_step.add(wait.thread)
            acquire_alert(wait.go, threading.TIMEOUT_MAX)
        except BaseException:  # Ctrl-C
            with self._lock:
                self._end(wait)
            raise
        finally:
            self._in_step.discard(wait.thread)

    # The watchdog.

    def _adjust_watchdog(self) -> None:
        """Run the watchdog as long as a thread waits for the turn or for time. Thread: holds the lock."""
        if self._watchdog is None:
            if self._ready or self._timed.first() is not None:
                self._watchdog = new_waiter()
                threading.Thread(
                    target=self._guard_turn, args=(self._watchdog,), name="clock watchdog", daemon=True
                ).start()
        elif not self._waits and not self._ready:
            release(self._watchdog)

    def _guard_turn(self, stop: threading.Lock) -> None:
        """Take the turn from threads that wait for something else. Thread: the watchdog's."""
        turns, idle_checks, begun_used_s, used_s, all_used_s = -1, 0, 0.0, 0.0, 0.0
        while True:
            with self._lock:
                if not self._waits and not self._ready:
                    self._watchdog = None
                    return
                holder, turn = self._running, self._turns
            if holder is not None:
                used_before_s, used_s = used_s, _processor_time_s(holder)
                all_used_before_s, all_used_s = all_used_s, time.process_time()
                if turn != turns:
                    turns, idle_checks, begun_used_s = turn, 0, all_used_s
                else:
                    is_idle = (
                        used_s - used_before_s < _IDLE_S
                        and holder not in self._in_step
                        and _state(holder.native_id) in {"S", None}
                    )
                    idle_checks = idle_checks + 1 if is_idle else 0
                others_work = all_used_s - all_used_before_s > _OTHERS_WORK * _CHECK_S or _some_want_to_run()
                checks = _IDLE_CHECKS_WHILE_OTHERS_WORK if others_work else _IDLE_CHECKS
                if idle_checks >= checks or all_used_s - begun_used_s > _PATIENCE_S or not holder.is_alive():
                    self._take_turn_from(holder, turn)
            stop.acquire(timeout=_CHECK_S)

    def _take_turn_from(self, holder: threading.Thread, turn: int) -> None:
        with self._lock:
            if self._turns != turn or self._running is not holder:
                return
            if holder.is_alive() and self._next() is not None:
                get_logger(thread=holder.name).warning(
                    "a thread waits for something other than the fleet's clock: time advances without it, and this run "
                    "may not repeat"
                )
            self._running = None
            self._dispatch_if_free()


def _processor_time_s(thread: threading.Thread) -> float:
    """Return the processor time of a thread, or of the process where the system cannot tell."""
    with contextlib.suppress(OSError):  # it has ended just now
        if thread.ident is not None and thread.is_alive() and hasattr(time, "pthread_getcpuclockid"):
            return time.clock_gettime(time.pthread_getcpuclockid(thread.ident))
    return time.process_time()


def _some_want_to_run() -> bool:
    """Return whether another thread of this process runs, or would if it had a processor.

    It detects the helper threads of a library that starve on a busy machine, which processor time does not show.
    """
    me = str(threading.get_native_id())
    with contextlib.suppress(OSError):
        return any(_state(task.name) in {"R", "D"} for task in Path("/proc/self/task").iterdir() if task.name != me)
    return False


def _state(task: int | str | None) -> str | None:
    """Return the letter of a thread's state in /proc; None if it has just ended, or there is no /proc."""
    try:
        stat = Path(f"/proc/self/task/{task}/stat").read_text(encoding="utf-8")
    except OSError:
        return None
    return stat.rpartition(")")[2].split()[0]


def clock_of(rate: Rate) -> Clock:
    """Return a new clock of that rate."""
    return LockStepClock() if rate == MAX else ScaledClock(rate)
