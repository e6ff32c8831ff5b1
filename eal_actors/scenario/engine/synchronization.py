"""The synchronization of tasks: meetings, signals, and pauses. Everything runs in the loop's thread."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any

from eal_actors.actors.future import Future
from eal_actors.kernel.clock import Clock
from eal_actors.scenario.engine.frames import Frame, StepTask
from eal_actors.scenario.language.scenario import Step
from eal_actors.scenario.report.events import RunEvent, RunPaused, RunResumed


def find_meetings(frame: Frame, steps: Sequence[Step]) -> frozenset[Hashable]:
    """Return the keys of the meetings among steps of a frame's scenario and the steps inside them."""
    return frozenset[Hashable]().union(*(_meetings_of(frame, step) for step in steps))


def _meetings_of(frame: Frame, step: Step) -> frozenset[Hashable]:
    if (known := frame.meets.get(id(step))) is None:
        key = step.meeting(frame)
        own = frozenset[Hashable](() if key is None else (key,))
        known = frame.meets[id(step)] = own.union(*(find_meetings(frame, inner) for _, inner in step.children()))
    return known


@dataclass(eq=False)
class Meeting:
    """The tasks that met, in the order of their arrival, and what they agree on; the first that continues sets it."""

    tasks: list[StepTask]
    agreement: Any = None


class Barriers:
    """The expected and the present tasks of each meeting.

    Every task that has a meeting among its steps is expected from its beginning to its end. While tasks inside it have
    the meeting too, they are expected in its place.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._expected: dict[Hashable, dict[StepTask, None]] = {}
        self._present: dict[Hashable, dict[StepTask, Future[Meeting]]] = {}
        self._inside: dict[tuple[Hashable, StepTask], int] = {}

    def enter(self, task: StepTask) -> None:
        """Expect a task. Call it for all tasks that begin at the same time, before any of them runs."""
        for key in task.meets:
            expected = self._expected.setdefault(key, {})
            expected[task] = None
            parent = task.parent
            if parent is not None and key in parent.meets:
                expected.pop(parent, None)
                self._inside[key, parent] = self._inside.get((key, parent), 0) + 1

    def leave(self, task: StepTask) -> None:
        """Expect a task no longer: it has ended."""
        for key in task.meets:
            expected = self._expected[key]
            expected.pop(task, None)
            parent = task.parent
            if parent is not None and key in parent.meets:
                self._inside[key, parent] -= 1
                if not self._inside[key, parent]:
                    del self._inside[key, parent]
                    expected[parent] = None
            self._release(key)
            if not expected:
                del self._expected[key]
                self._present.pop(key, None)

    def arrive(self, key: Hashable, task: StepTask) -> Future[Meeting]:
        """Return a future that is done when all expected tasks are present."""
        future: Future[Meeting] = Future(self._clock)
        self._present.setdefault(key, {})[task] = future
        self._release(key)
        return future

    def withdraw(self, key: Hashable, task: StepTask) -> None:
        """Stop waiting; it has no effect after the meeting."""
        self._present.get(key, {}).pop(task, None)

    def missing(self, key: Hashable, task: StepTask) -> str:
        """Return the names of the expected tasks other than `task` that are not present; of many, the first three."""
        present = self._present.get(key, {})
        names = [one.name for one in self._expected.get(key, {}) if one not in present and one.name != task.name]
        return ", ".join(names) if len(names) <= 3 else f"{', '.join(names[:3])} and {len(names) - 3} more"

    def _release(self, key: Hashable) -> None:
        present = self._present.get(key)
        expected = self._expected[key]
        if present and len(present) >= len(expected) and all(task in present for task in expected):
            self._present[key] = {}
            meeting = Meeting(list(present))
            for future in present.values():
                future.set(meeting)


class Signals:
    """The signals of a run: latched, counted, and with a value. `values` has the last value of each."""

    def __init__(self, clock: Clock) -> None:
        self.counts: dict[tuple[Frame, str], int] = {}
        self.values: dict[tuple[Frame, str], Any] = {}
        self._clock = clock
        self._waiting: dict[tuple[Frame, str], dict[Future[Any], int]] = {}

    def give(self, frame: Frame, name: str, value: Any) -> int:
        """Give a signal; return how often it was given so far."""
        key = (frame, name)
        count = self.counts[key] = self.counts.get(key, 0) + 1
        self.values[key] = value
        waiting = self._waiting.get(key, {})
        for future in [future for future, wanted in waiting.items() if wanted <= count]:
            del waiting[future]
            future.set(value)
        return count

    def wait(self, frame: Frame, name: str, count: int = 1) -> Future[Any]:
        """Return a future of the last value, done when the signal was given this often."""
        key = (frame, name)
        future: Future[Any] = Future(self._clock)
        if self.counts.get(key, 0) >= count:
            future.set(self.values[key])
        else:
            self._waiting.setdefault(key, {})[future] = count
        return future

    def withdraw(self, frame: Frame, name: str, future: Future[Any]) -> None:
        """Stop waiting; it has no effect once the signal was given."""
        self._waiting.get((frame, name), {}).pop(future, None)

    def forget(self, frame: Frame) -> None:
        """Forget the signals of a scenario that is over."""
        for table in (self.counts, self.values, self._waiting):
            for key in [key for key in table if key[0] is frame]:
                del table[key]


class PauseControl:
    """Decides whether steps may begin: pauses, and single steps."""

    def __init__(self, clock: Clock, emit: Callable[[Callable[[float], RunEvent]], float]) -> None:
        self._clock = clock
        self._emit = emit
        self._since_s: float | None = None
        self._paused_s = 0.0
        self._granted = 0
        self._granted_before = 0
        self._waiting: list[Future[None]] = []

    @property
    def is_paused(self) -> bool:
        """Whether no step begins, except for single steps."""
        return self._since_s is not None

    @property
    def paused_s(self) -> float:
        """The total time of pauses so far, in seconds of the fleet's clock."""
        return self._paused_s + (self._clock.now() - self._since_s if self._since_s is not None else 0.0)

    def active_s(self) -> float:
        """Return a time that does not advance during pauses."""
        return self._clock.now() - self.paused_s

    def pause(self) -> None:
        """Begin no more steps."""
        if self._since_s is None:
            self._since_s = self._clock.now()
            self._granted_before = self._granted
            self._emit(RunPaused)

    def resume(self) -> None:
        """End a pause."""
        if self._since_s is not None:
            self.end()
            self._emit(lambda time_s: RunResumed(time_s, is_single_step=False))

    def step(self) -> None:
        """Let each task begin one step; pause a run that is not paused."""
        if self._since_s is None:
            self.pause()
            return
        self._granted += 1
        self._emit(lambda time_s: RunResumed(time_s, is_single_step=True))
        self._wake()

    def end(self) -> None:
        """End a pause without an event: the run is being stopped, and its end must not wait."""
        if self._since_s is not None:
            self._paused_s += self._clock.now() - self._since_s
            self._since_s = None
            self._wake()

    def _wake(self) -> None:
        waiting, self._waiting = self._waiting, []
        for future in waiting:
            future.set()

    def admits(self, task: StepTask) -> bool:
        """Return whether a task may begin a step now, and record that it does."""
        if self._since_s is None:
            return True
        if max(task.steps_taken, self._granted_before) < self._granted:
            task.steps_taken = self._granted
            return True
        return False

    def change(self) -> Future[None]:
        """Return a future that is done at the next change."""
        future: Future[None] = Future(self._clock)
        self._waiting.append(future)
        return future
