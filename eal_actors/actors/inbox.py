"""The mailbox of an actor: a bounded normal lane, an urgent lane and timers.

Urgent messages come first. Then come due timers and the normal lane; a timer set after the oldest waiting call lets
that call go first, so that timers that are always due cannot starve the calls. Each lane is first in, first out.

Another thread may take the reader's place while the reader waits, for a call or for due timers: then it alone runs the
actor's code until it gives the place back.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from eal_actors.kernel.clock import ROUNDING_S, Clock, Timer, TimerHeap, new_waiter
from eal_actors.kernel.errors import BusyError, EALError


class Envelope(Protocol):
    """An entry of an inbox: Pykka's envelope, a Call or an Action, which are their own envelopes."""

    @property
    def message(self) -> Any:
        """The message to handle."""

    @property
    def reply_to(self) -> Any:
        """Pykka's future for the answer, or None."""


class Action(Timer):
    """A timer in an inbox: its own envelope and its own message."""

    __slots__ = ()

    reply_to = None

    @property
    def message(self) -> Action:
        """The message of this envelope: the action itself."""
        return self

    def run(self) -> None:
        """Run it, unless it was cancelled. Thread: the actor's own, or one in its place."""
        action, self.action = self.action, None
        if action is not None:
            action()


class Inbox:
    """A mailbox for one reading thread and any number of writing ones; see the module.

    `put` never blocks: a full lane raises BusyError at once.

    Args:
        capacity: the most envelopes that may wait in a lane.
    """

    def __init__(self, clock: Clock, capacity: int = 256) -> None:
        self.clock = clock
        self.capacity = capacity
        self._lock = threading.Lock()
        self._wakeup = new_waiter()
        self._reader_waits = False
        self._wakes_at_s = math.inf
        self._borrower: object = None
        self._urgent: deque[Envelope] = deque()
        self._normal: deque[tuple[int, Envelope]] = deque()
        self._timers: TimerHeap[Action] = TimerHeap()
        self._order = itertools.count()
        self._closed_by: EALError | None = None
        self.serve: Callable[[], float] | None = None
        """Runs the due timers in the reader's place; None if only the reader may. See `Clock.wait`."""

    def __len__(self) -> int:
        return len(self._urgent) + len(self._normal)

    def empty(self) -> bool:
        """Return whether no envelope waits; timers do not count. Thread: any."""
        return not self._urgent and not self._normal

    def waiting(self) -> list[Envelope]:
        """Return the envelopes that wait, the urgent ones first, without timers. Thread: any; never blocks."""
        with self._lock:
            return self._envelopes()

    def _envelopes(self) -> list[Envelope]:
        return [*self._urgent, *(envelope for _, envelope in self._normal)]

    def put(self, envelope: Envelope) -> None:
        """Add to the normal lane.

        Raises:
            BusyError: the lane is full.
            EALError: the inbox was closed with this error.

        Thread: any; never blocks.
        """
        with self._lock:
            if self._closed_by is not None:
                raise self._closed_by.copy()
            if len(self._normal) >= self.capacity:
                raise BusyError(f"its mailbox is full ({self.capacity} calls wait)")
            self._normal.append((next(self._order), envelope))
            if self._reader_waits:  # as _wake_reader
                self.clock.wake(self._wakeup)
                self._reader_waits = False

    def put_urgent(
        self, envelope: Envelope, *, bounded: bool = True, drop: Callable[[Envelope], bool] | None = None
    ) -> list[Envelope]:
        """Add to the urgent lane.

        Args:
            envelope: the envelope.
            bounded: whether a full lane refuses it; a stop is never refused.
            drop: selects envelopes of the normal lane to take out in the same instant; None for none.

        Returns:
            The envelopes taken out.

        Raises:
            BusyError: the lane is full of calls.
            EALError: the inbox was closed with this error.

        Thread: any; never blocks.
        """
        with self._lock:
            if self._closed_by is not None:
                raise self._closed_by.copy()
            if bounded and len(self._urgent) >= self.capacity and self._count_urgent_calls() >= self.capacity:
                raise BusyError(f"its mailbox is full ({self.capacity} urgent calls wait)")
            dropped: list[Envelope] = []
            if drop is not None and self._normal:
                dropped = [waiting for _, waiting in self._normal if drop(waiting)]
                if dropped:
                    self._normal = deque(entry for entry in self._normal if not drop(entry[1]))
            self._urgent.append(envelope)
            self._wake_reader()
        return dropped

    def _count_urgent_calls(self) -> int:
        """Return how many calls wait in the urgent lane; the actor's own actions do not count."""
        return sum(type(envelope) is not Action for envelope in self._urgent)

    def call_at(self, time_s: float, action: Callable[[], None]) -> Action:
        """Run the action in the reading thread when the clock shows `time_s`. Thread: any; never blocks."""
        with self._lock:
            timer = Action(time_s, next(self._order), action)
            self._timers.add(timer)
            if time_s < self._wakes_at_s:  # otherwise the reader wakes up in time by itself
                self._wake_reader()
        return timer

    def call_soon(self, action: Callable[[], object]) -> None:
        """Run the action in the reading thread before everything that waits; a full lane does not refuse it.

        Raises:
            EALError: the inbox was closed with this error.

        Thread: any; never blocks.
        """
        self.put_urgent(Action(0.0, 0, action), bounded=False)

    def call_later(self, delay_s: float, action: Callable[[], None]) -> Action:
        """Run the action in the reading thread after a delay. Thread: any; never blocks."""
        return self.call_at(self.clock.now() + delay_s, action)

    def get(self) -> Envelope:
        """Wait for the next envelope. Thread: the one reader; blocks it."""
        while True:
            with self._lock:
                self._reader_waits = False
                timer, timeout_s = None, None
                if self._borrower is None:
                    if self._urgent:
                        return self._urgent.popleft()
                    if self._timers.heap and (timer := self._timers.first()) is not None:
                        timeout_s = timer.time_s - self.clock.now()
                        if timeout_s <= ROUNDING_S and not (self._normal and self._normal[0][0] < timer.order):
                            self._timers.pop()
                            return timer
                    if self._normal:
                        return self._normal.popleft()[1]
                self._reader_waits = True
                self._wakes_at_s = math.inf if timer is None else timer.time_s
            self.clock.wait(self._wakeup, timeout_s, self.serve)

    def borrow(self, borrower: object) -> bool:
        """Take the reader's place while it waits and nothing else does; return whether the caller has it now.

        The reader returns no envelope until `give_back`. Thread: any; never blocks.
        """
        with self._lock:
            if not self._reader_waits or self._borrower is not None or self._urgent or self._normal:
                return False
            if self._wakes_at_s - self.clock.now() <= ROUNDING_S:  # a timer is due
                return False
            self._borrower = borrower
        return True

    def give_back(self, borrower: object) -> None:
        """End `borrow`, if that borrower has the reader's place. Thread: the one that borrowed it; never blocks."""
        with self._lock:
            if self._borrower is borrower:
                self._borrower = None
                timer = self._timers.first()
                if self._urgent or self._normal or (timer is not None and timer.time_s < self._wakes_at_s):
                    self._wake_reader()

    def borrow_timer(self, borrower: object) -> Action | None:
        """Take the reader's place for a timer that is due, if the reader waits and nothing else does; see `borrow`."""
        with self._lock:
            if not self._reader_waits or self._borrower is not None or self._urgent or self._normal:
                return None
            timer = self._timers.first()
            if timer is None or timer.time_s - self.clock.now() > ROUNDING_S:
                return None
            self._borrower = borrower
            return self._timers.pop()

    def set_reader_time(self) -> float:
        """Let the waiting reader wake up at its next timer; return that time. Thread: the one that serves for it."""
        with self._lock:
            timer = self._timers.first() if self._borrower is None else None
            time_s = math.inf if timer is None else timer.time_s
            if self._reader_waits:
                self._wakes_at_s = time_s
            return time_s

    def close(self, error: EALError) -> list[Envelope]:
        """Refuse all further envelopes with the error, the first one given; return those that waited. Thread: any."""
        with self._lock:
            self._closed_by = self._closed_by or error
            waiting = self._envelopes()
            self._urgent.clear()
            self._normal.clear()
            self._timers.clear()
            self._wake_reader()
        return waiting

    def _wake_reader(self) -> None:
        if self._reader_waits:
            self.clock.wake(self._wakeup)  # first: Ctrl-C may strike in between, and one wake-up too many is harmless
            self._reader_waits = False
