"""Activities that take turns on a clock which moves only while something runs."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from itertools import count
from typing import Any

from eal_actors.kernel.errors import EALError


class DueActivities:
    """Steps activities in the order of their wake-ups. Thread: one.

    Args:
        now: returns the clock's time in seconds.
        pass_until: lets time pass until a time in seconds, if that is still to come.
        failures: the exceptions that are results; others leave `step`.
    """

    def __init__(
        self,
        now: Callable[[], float],
        pass_until: Callable[[float], None],
        failures: type[Exception] = EALError,
    ) -> None:
        self.results: dict[int, Any] = {}
        """The result of each finished activity, or its exception."""
        self._now = now
        self._pass_until = pass_until
        self._failures = failures
        self._order = count()
        self._due: list[tuple[float, int, Any]] = []

    def begin(self, activity: Any) -> int:
        """Begin an activity now and return its number."""
        number = next(self._order)
        heapq.heappush(self._due, (self._now(), number, activity))
        return number

    def step(self, until_s: float) -> bool:
        """Step the activity that is due next; return False if none is due by then."""
        if not self._due or self._due[0][0] > until_s:
            return False
        at_s, number, activity = heapq.heappop(self._due)
        self._pass_until(at_s)
        try:
            delay_s = next(activity)
        except StopIteration as end:
            self.results[number] = end.value
        except self._failures as error:
            self.results[number] = error
        else:
            heapq.heappush(self._due, (self._now() + delay_s, number, activity))
        return True

    def wait(self, duration_s: float) -> None:
        """Let time pass, with everything at work."""
        end_s = self._now() + duration_s
        while self.step(end_s):
            pass
        self._pass_until(end_s)

    def postpone(self, until_s: float) -> None:
        """Step nothing before a time."""
        self._due = [(max(at_s, until_s), number, activity) for at_s, number, activity in self._due]
        heapq.heapify(self._due)

    def close(self, number: int) -> None:
        """Close an activity that has not ended, as a halt does."""
        for entry in [entry for entry in self._due if entry[1] == number]:
            self._due.remove(entry)
            heapq.heapify(self._due)
            entry[2].close()
