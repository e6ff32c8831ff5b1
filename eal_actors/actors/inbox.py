"""The mailbox: a bounded lane, an urgent lane that goes first, and timers."""

from __future__ import annotations

import itertools
import math
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from eal_actors.kernel.clock import Clock, new_waiter
from eal_actors.kernel.errors import BusyError, EALError
from eal_actors.kernel.timers import ROUNDING_S, Timer, TimerHeap


class Envelope(Protocol):
    """What an inbox holds: Pykka's envelope, or a Call, which is its own."""

    @property
    def message(self) -> Any:
        """What is to be handled."""
        ...

    @property
    def reply_to(self) -> Any:
        """Pykka's future for the answer, or None."""
        ...


class Action(Timer):
    """A timer as an inbox holds it: its own envelope, and its own message."""

    __slots__ = ()

    reply_to = None

    @property
    def message(self) -> Action:
        """See Envelope."""
        return self


class Inbox:
    """A mailbox for one reading thread and any number of writing ones.

    `put` never blocks: a full lane raises BusyError at once. What is urgent is read before everything else. Then come
    timers that are due, and the normal lane; a timer that was set after the oldest waiting call lets that go first, so
    that timers that are always due keep nothing out. Within each lane, first in, first out.

    Args:
        clock: the clock of its timers.
        capacity: the most envelopes that may wait in a lane.
    """

    def __init__(self, clock: Clock, capacity: int = 256) -> None:
        self.clock = clock
        self.capacity = capacity
        self._lock = threading.Lock()
        self._wakeup = new_waiter()
        self._reader_waits = False
        self._wakes_at_s = math.inf
        self._urgent: deque[Envelope] = deque()
        self._normal: deque[tuple[int, Envelope]] = deque()
        self._timers: TimerHeap[Action] = TimerHeap()
        self._order = itertools.count()
        self._closed_by: EALError | None = None

    def __len__(self) -> int:
        return len(self._urgent) + len(self._normal)

    def empty(self) -> bool:
        """Return whether no envelope waits; timers do not count. Thread: any."""
        return not self._urgent and not self._normal

    def waiting(self) -> list[Envelope]:
        """Return what waits now, the urgent first; timers do not count. Thread: any; never blocks."""
        with self._lock:
            return [*self._urgent, *(envelope for _, envelope in self._normal)]

    def put(self, envelope: Envelope) -> None:
        """Add to the normal lane.

        Raises:
            BusyError: the lane is full.
            EALError: what the inbox was closed with.

        Thread: any; never blocks.
        """
        with self._lock:
            if self._closed_by is not None:
                raise self._closed_by.copy()
            if len(self._normal) >= self.capacity:
                raise BusyError(f"its mailbox is full ({self.capacity} calls wait)")
            self._normal.append((next(self._order), envelope))
            self._wake_reader()

    def put_urgent(
        self, envelope: Envelope, *, bounded: bool = True, drop: Callable[[Envelope], bool] | None = None
    ) -> list[Envelope]:
        """Add to the urgent lane.

        Args:
            envelope: what to add.
            bounded: whether a full lane refuses it; what keeps people safe is never refused.
            drop: which envelopes of the normal lane to take out in the same instant; None for none.

        Returns:
            The envelopes taken out.

        Raises:
            BusyError: the lane is full of calls.
            EALError: what the inbox was closed with.

        Thread: any; never blocks.
        """
        with self._lock:
            if self._closed_by is not None:
                raise self._closed_by.copy()
            if bounded and len(self._urgent) >= self.capacity and self._count_urgent() >= self.capacity:
                raise BusyError(f"its mailbox is full ({self.capacity} urgent calls wait)")
            dropped: list[Envelope] = []
            if drop is not None and self._normal:
                dropped = [waiting for _, waiting in self._normal if drop(waiting)]
                if dropped:
                    self._normal = deque(entry for entry in self._normal if not drop(entry[1]))
            self._urgent.append(envelope)
            self._wake_reader()
        return dropped

    def _count_urgent(self) -> int:
        """Return how many calls wait in the urgent lane: the actor's own actions are nobody's calls."""
        return sum(type(envelope) is not Action for envelope in self._urgent)

    def call_at(self, time_s: float, action: Callable[[], None]) -> Action:
        """Run the action in the reading thread when the clock shows `time_s`. Thread: any; never blocks."""
        with self._lock:
            timer = Action(time_s, next(self._order), action)
            self._timers.add(timer)
            if time_s < self._wakes_at_s:  # else the reader looks in time by itself
                self._wake_reader()
        return timer

    def call_soon(self, action: Callable[[], None]) -> None:
        """Run the action in the reading thread before everything that waits; never refused for a full lane.

        Raises:
            EALError: what the inbox was closed with.

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
                if self._urgent:
                    return self._urgent.popleft()
                timer, timeout_s = self._timers.first(), None
                if timer is not None:
                    timeout_s = timer.time_s - self.clock.now()
                    if timeout_s <= ROUNDING_S and not self._has_waited_since_before(timer):
                        self._timers.pop()
                        return timer
                if self._normal:
                    return self._normal.popleft()[1]
                self._reader_waits = True
                self._wakes_at_s = math.inf if timer is None else timer.time_s
            self.clock.wait(self._wakeup, timeout_s)
            # After a time-out a writer may still believe that we wait: its release only makes one wait too short.

    def close(self, error: EALError) -> list[Envelope]:
        """Refuse everything from now on with the error; returns what was waiting.

        The first reason stands. Thread: any.
        """
        with self._lock:
            self._closed_by = self._closed_by or error
            waiting = [*self._urgent, *(envelope for _, envelope in self._normal)]
            self._urgent.clear()
            self._normal.clear()
            self._timers.clear()
            self._wake_reader()
        return waiting

    def _has_waited_since_before(self, timer: Timer) -> bool:
        """Return whether a call waited when the timer was set: timers that are always due must not keep it out."""
        return bool(self._normal) and self._normal[0][0] < timer.order

    def _wake_reader(self) -> None:
        if self._reader_waits:
            self.clock.wake(
                self._wakeup
            )  # first, because Ctrl-C may strike in between: one wake-up too many is harmless
            self._reader_waits = False
