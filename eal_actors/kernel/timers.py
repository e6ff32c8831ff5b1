"""Actions for later, in the order of their times."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from typing import Final, Generic, TypeVar

ROUNDING_S: Final = 1e-9
"""A timer this close is due: now + (time - now) is not always time."""

_SWEEP_AT: Final = 1024


class Timer:
    """An action for later.

    Args:
        time_s: when, in seconds of a clock.
        order: which of two timers of one time goes first: the lower.
        action: what to do; None once it is done or called off.
    """

    __slots__ = ("action", "order", "time_s")

    def __init__(self, time_s: float, order: int, action: Callable[[], None]) -> None:
        self.time_s = time_s
        self.order = order
        self.action: Callable[[], None] | None = action

    def cancel(self) -> None:
        """Call it off; harmless when it has rung. Thread: any, for it is one assignment."""
        self.action = None


R = TypeVar("R", bound=Timer)


class TimerHeap(Generic[R]):
    """Timers by their times. Those called off are swept out before they pile up. Thread: its owner locks it."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, R]] = []
        self._sweep_at = _SWEEP_AT

    def __len__(self) -> int:
        return len(self._heap)

    def add(self, timer: R) -> None:
        """Add a timer."""
        heapq.heappush(self._heap, (timer.time_s, timer.order, timer))
        if len(self._heap) > self._sweep_at:
            self._heap = [entry for entry in self._heap if entry[2].action is not None]
            heapq.heapify(self._heap)
            self._sweep_at = max(_SWEEP_AT, 2 * len(self._heap))

    def first(self) -> R | None:
        """Return the timer that rings next, or None."""
        while self._heap and self._heap[0][2].action is None:
            heapq.heappop(self._heap)
        return self._heap[0][2] if self._heap else None

    def pop(self) -> R:
        """Take out the timer that `first` returned."""
        return heapq.heappop(self._heap)[2]

    def clear(self) -> None:
        """Forget them all."""
        self._heap.clear()
