"""Signals between robots: latched, counted, with a value."""

from __future__ import annotations

from typing import Any

from eal_actors.actors.future import Future
from eal_actors.kernel.clock import Clock
from eal_actors.scenario.engine.cast import Unit


class Signals:
    """The signals of a run. Everything happens in the loop's thread.

    Args:
        clock: the fleet's clock.

    Attributes:
        counts: how often each was given.
        values: what came with it last.
    """

    def __init__(self, clock: Clock) -> None:
        self.counts: dict[tuple[Unit, str], int] = {}
        self.values: dict[tuple[Unit, str], Any] = {}
        self._clock = clock
        self._waiting: dict[tuple[Unit, str], list[tuple[int, Future[Any]]]] = {}

    def give(self, unit: Unit, name: str, value: Any) -> int:
        """Give a signal; return how often it was given so far."""
        key = (unit, name)
        count = self.counts[key] = self.counts.get(key, 0) + 1
        self.values[key] = value
        waiting = self._waiting.pop(key, [])
        self._waiting[key] = [(wanted, future) for wanted, future in waiting if wanted > count]
        for wanted, future in waiting:
            if wanted <= count:
                future.set(value)
        return count

    def wait(self, unit: Unit, name: str, count: int = 1) -> Future[Any]:
        """Return a future of the newest value, done when the signal was given so often."""
        key = (unit, name)
        future: Future[Any] = Future(self._clock)
        if self.counts.get(key, 0) >= count:
            future.set(self.values[key])
        else:
            self._waiting.setdefault(key, []).append((count, future))
        return future
