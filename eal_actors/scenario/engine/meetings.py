"""Where lines of steps meet: barriers, and starts at the same time."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

from eal_actors.actors.future import Future
from eal_actors.kernel.clock import Clock
from eal_actors.scenario.engine.cast import Task, Unit
from eal_actors.scenario.model import AnyStep, BarrierStep, CallStep, inner_steps


def meeting_key(unit: Unit, step: BarrierStep | CallStep) -> Hashable:
    """Return what tells a meeting from others: barriers go by their names, starts together by their places."""
    return (unit, step.barrier) if isinstance(step, BarrierStep) else (unit, id(step))


def meets_in(unit: Unit, steps: Sequence[AnyStep]) -> frozenset[Hashable]:
    """Return the meetings among steps and the steps inside them."""
    found = unit.meets.get(id(steps))
    if found is None:
        keys: set[Hashable] = set()
        for step in steps:
            if isinstance(step, BarrierStep) or (isinstance(step, CallStep) and step.is_together):
                keys.add(meeting_key(unit, step))
            for _, inner in inner_steps(step):
                keys |= meets_in(unit, inner)
        found = unit.meets[id(steps)] = frozenset(keys)
    return found


@dataclass(eq=False)
class Met:
    """A meeting that has come about.

    Attributes:
        tasks: those who met, in the order in which they came.
        outcome: what they agree on, for whoever comes first to set.
    """

    tasks: list[Task]
    outcome: Any = None


class Meetings:
    """Knows for each meeting who is expected and who is there. Everything happens in the loop's thread.

    Expected is every line of steps that has the meeting among its steps, from its beginning to its end. As long as
    lines inside it have it too, they stand for it.

    Args:
        clock: the fleet's clock.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._expected: dict[Hashable, dict[Task, None]] = {}
        self._present: dict[Hashable, dict[Task, Future[Met]]] = {}
        self._inside: dict[tuple[Hashable, Task], int] = {}

    def enter(self, task: Task) -> None:
        """A line of steps begins: call it for all that begin at once, before any of them goes on."""
        for key in task.meets:
            expected = self._expected.setdefault(key, {})
            expected[task] = None
            parent = task.parent
            if parent is not None and key in parent.meets:
                expected.pop(parent, None)
                self._inside[key, parent] = self._inside.get((key, parent), 0) + 1

    def leave(self, task: Task) -> None:
        """A line of steps has ended: it is waited for no longer."""
        for key in task.meets:
            expected = self._expected[key]
            expected.pop(task, None)
            parent = task.parent
            if parent is not None and key in parent.meets:
                self._inside[key, parent] -= 1
                if not self._inside[key, parent]:
                    expected[parent] = None
            self._look(key)

    def arrive(self, key: Hashable, task: Task) -> Future[Met]:
        """Return a future that is done when everyone is there."""
        future: Future[Met] = Future(self._clock)
        self._present.setdefault(key, {})[task] = future
        self._look(key)
        return future

    def withdraw(self, key: Hashable, task: Task) -> None:
        """Wait no longer; harmless after the meeting."""
        self._present.get(key, {}).pop(task, None)

    def absent(self, key: Hashable) -> list[str]:
        """Return who is expected and not there."""
        present = self._present.get(key, {})
        return [task.name for task in self._expected.get(key, {}) if task not in present]

    def _look(self, key: Hashable) -> None:
        present = self._present.get(key)
        expected = self._expected[key]
        if present and len(present) >= len(expected) and all(task in present for task in expected):
            self._present[key] = {}
            met = Met(list(present))
            for future in present.values():
                future.set(met)
