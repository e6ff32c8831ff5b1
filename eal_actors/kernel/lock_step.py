"""A clock that jumps: as fast as the machine goes, and the same on every run.

Of the threads that count, one at a time has *the turn*. It keeps the turn until it waits. Then the next thread that was
woken has it, in the order of the wake-ups; where none was, everybody waits for time, and time jumps to the earliest end
of a wait. So the threads run one after the other in an order that depends on nothing but what they do, however busy
the machine is: whatever they do is repeatable.

Where threads keep one another busy without end, such as one that asks for a value until it changes, time goes on after
a number of turns: such a loop ends, if later than one that sleeps between two looks.

A thread counts as soon as it waits on the clock, or was started by `LockStepClock.start`. A thread that has the turn
and waits for something else (a socket, a key, another thread) would keep everybody waiting. A watch notices it, takes
the turn away, and says so; the thread counts again as soon as it waits on the clock. What such a thread does is not
repeatable. `outside` is for code that knows beforehand that it waits for something else.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar, Final, Literal, TypeAlias

from eal_actors.kernel.clock import Clock, ScaledClock, acquire_alert, new_waiter, release, wait_in_scope
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.timers import Timer, TimerHeap

MAX: Final = "max"
"""The rate of a clock that goes as fast as the machine."""

Rate: TypeAlias = float | Literal["max"]
"""Seconds of a clock in one real second, or MAX."""

_LOOK_S: Final = 0.25
_IDLE_LOOKS: Final = 2
_IDLE_LOOKS_WHILE_OTHERS_WORK: Final = 20
_IDLE_S: Final = 0.001
"""A thread that has the turn, sleeps at every look and uses less processor time than this in between, this many times,
waits for something; who wakes up now and then to see whether it came, uses some. If other threads of the process work
meanwhile, or want a processor to, it may be for it, as those of OpenCV do: then it takes more looks to tell."""
_OTHERS_WORK: Final = 0.2
"""Share of the time that a process works at least to count as working."""

_PATIENCE_S: Final = 30.0
"""Processor time that the process may use in one turn before time goes on without the thread that has it."""


_TURNS_AT_ONCE: Final = 100
_TURNS_AT_ONCE_EACH: Final = 10
"""So many turns, and so many more for each thread that waits, may be taken while time stands still."""


class _Wait(Timer):
    """One thread's wait: for a waiter, for a time, or only for the turn.

    Attributes:
        thread: whose it is.
        waiter: what it waits on; None where it only waits for the turn.
        go: held until the thread has the turn.
        was_released: True if the waiter was released, False if the time passed.
        is_over: the thread has the turn, or has given up waiting.
    """

    __slots__ = ("go", "is_over", "thread", "waiter", "was_released")

    def __init__(
        self, thread: threading.Thread, waiter: threading.Lock | None = None, time_s: float = 0.0, order: int = 0
    ) -> None:
        super().__init__(time_s, order, self._nothing)
        self.thread = thread
        self.waiter = waiter
        self.go = new_waiter()
        self.was_released = False
        self.is_over = False

    @staticmethod
    def _nothing() -> None:
        """Stand for the action that a live timer has."""


class LockStepClock:
    """See the module. It implements `Clock`."""

    rate: Final = MAX

    def __init__(self) -> None:
        self._now = 0.0
        self._lock = threading.RLock()  # a signal's handler may wake somebody while its thread holds the lock
        self._order = itertools.count()
        self._running: threading.Thread | None = None
        self._turns = 0
        self._jumped_at = 0
        self._ready: deque[_Wait] = deque()
        self._waits: dict[threading.Lock, _Wait] = {}
        self._timed: TimerHeap[_Wait] = TimerHeap()
        self._watch: threading.Lock | None = None

    _in_step: ClassVar[set[threading.Thread]] = set()
    """The threads that wait for their turn, on whatever clock."""

    def now(self) -> float:
        """See Clock."""
        return self._now

    def of_real(self, duration_s: float) -> float:
        """See Clock: there is no rate, so a time-out is taken as seconds of this clock."""
        return duration_s

    def wait(self, waiter: threading.Lock, timeout_s: float | None) -> bool:
        """See Clock. A time-out of 0 lets those go first that are ready."""
        time_s = self._now + (timeout_s or 0.0)
        wait = _Wait(threading.current_thread(), waiter, time_s, next(self._order))
        with self._lock:
            self._waits[waiter] = wait  # before a look at the waiter, or a signal's release in between would be lost
            if waiter.acquire(blocking=False):
                self._end(wait)
                return True
            if timeout_s is not None and timeout_s <= 0:
                self._ready.append(wait)
            elif timeout_s is not None:
                self._timed.add(wait)
            self._hand_over()
        self._await_turn(wait)
        return wait.was_released

    def wake(self, waiter: threading.Lock) -> None:
        """See Clock."""
        with self._lock:
            wait = self._waits.pop(waiter, None)
            if wait is None:
                release(waiter)
                return
            wait.was_released = True
            wait.cancel()
            self._ready.append(wait)
            self._dispatch_if_free()

    def sleep(self, duration_s: float) -> None:
        """See Clock."""
        wait_in_scope(self, new_waiter(), duration_s)

    def start(self, thread: threading.Thread) -> None:
        """See Clock."""
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

    @contextlib.contextmanager
    def outside(self) -> Iterator[None]:
        """See Clock."""
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

    # The turn. Its steps are in an order in which Ctrl-C may strike between any two.

    def _hand_over(self) -> None:
        """Give the turn to the next, if the calling thread has it or nobody has. Thread: holds the lock."""
        if self._running is threading.current_thread():
            self._running = None
        self._dispatch_if_free()

    def _dispatch_if_free(self) -> None:
        """Give the turn to the next if nobody has it. Thread: holds the lock."""
        if self._running is None:
            wait = self._next()
            if wait is not None:
                release(wait.go)
                self._running = wait.thread
                self._turns += 1
                self._end(wait)
                if self._ready and self._ready[0] is wait:
                    self._ready.popleft()
        self._see_to_watch()

    def _next(self) -> _Wait | None:
        """Return the wait that ends next; time jumps to its end where that lies ahead. Thread: holds the lock."""
        while self._ready and self._ready[0].is_over:
            self._ready.popleft()
        wait = self._timed.first()
        if self._ready and (wait is None or not self._is_spinning()):
            return self._ready[0]
        if wait is not None:
            self._now = max(self._now, wait.time_s)
            self._jumped_at = self._turns
        return wait

    def _is_spinning(self) -> bool:
        """Return whether threads keep one another busy, such as by asking for a value over and over.

        On a clock that runs, that takes time. So time goes on as if it had.
        """
        return self._turns - self._jumped_at > _TURNS_AT_ONCE + _TURNS_AT_ONCE_EACH * len(self._waits)

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

    # The watch.

    def _see_to_watch(self) -> None:
        """Have a watch as long as somebody waits for the turn or for time. Thread: holds the lock."""
        if self._watch is None:
            if self._ready or self._timed.first() is not None:
                self._watch = new_waiter()
                threading.Thread(target=self._keep_watch, args=(self._watch,), name="clock watch", daemon=True).start()
        elif not self._waits and not self._ready:
            release(self._watch)

    def _keep_watch(self, stop: threading.Lock) -> None:
        """Take the turn from threads that wait for something else."""
        turns, idle_looks, begun_used_s, used_s, all_used_s = -1, 0, 0.0, 0.0, 0.0
        while True:
            with self._lock:
                if not self._waits and not self._ready:
                    self._watch = None
                    return
                holder, turn = self._running, self._turns
            if holder is not None:
                used_before_s, used_s = used_s, _processor_time_s(holder)
                all_used_before_s, all_used_s = all_used_s, time.process_time()
                if turn != turns:
                    turns, idle_looks, begun_used_s = turn, 0, all_used_s
                else:
                    is_idle = used_s - used_before_s < _IDLE_S and holder not in self._in_step and _sleeps(holder)
                    idle_looks = idle_looks + 1 if is_idle else 0
                others_work = all_used_s - all_used_before_s > _OTHERS_WORK * _LOOK_S or _some_want_to_run()
                looks = _IDLE_LOOKS_WHILE_OTHERS_WORK if others_work else _IDLE_LOOKS
                if idle_looks >= looks or all_used_s - begun_used_s > _PATIENCE_S or not holder.is_alive():
                    self._go_on_without(holder, turn)
            stop.acquire(timeout=_LOOK_S)

    def _go_on_without(self, holder: threading.Thread, turn: int) -> None:
        with self._lock:
            if self._turns != turn or self._running is not holder:
                return
            if holder.is_alive() and self._next() is not None:
                get_logger(thread=holder.name).warning(
                    "a thread waits for something other than the fleet's clock: time goes on without it, and this run "
                    "may not repeat"
                )
            self._running = None
            self._dispatch_if_free()


def _processor_time_s(thread: threading.Thread) -> float:
    """Return the processor time that a thread has used; that of the process where the system tells no better."""
    with contextlib.suppress(OSError):  # it has ended just now
        if thread.ident is not None and thread.is_alive() and hasattr(time, "pthread_getcpuclockid"):
            return time.clock_gettime(time.pthread_getcpuclockid(thread.ident))
    return time.process_time()


def _sleeps(thread: threading.Thread) -> bool:
    """Return whether a thread waits for something that is no processor and no disk; True if the system cannot tell."""
    return _state(thread.native_id) in {"S", None}


def _some_want_to_run() -> bool:
    """Return whether a thread of this process runs or would if it had a processor; the calling one does not count.

    It tells the helpers of a library that are starved on a busy machine, whose processor time says nothing.
    """
    me = str(threading.get_native_id())
    with contextlib.suppress(OSError):
        return any(_state(task.name) in {"R", "D"} for task in Path("/proc/self/task").iterdir() if task.name != me)
    return False


def _state(task: int | str | None) -> str | None:
    """Return the letter of a thread's state in /proc; None if it has ended just now, or there is no /proc."""
    try:
        stat = Path(f"/proc/self/task/{task}/stat").read_text(encoding="utf-8")
    except OSError:
        return None
    return stat.rpartition(")")[2].split()[0]


def clock_of(rate: Rate) -> Clock:
    """Return a new clock of a rate."""
    return LockStepClock() if rate == MAX else ScaledClock(rate)
