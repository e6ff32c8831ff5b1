"""Pauses, and single steps."""

from __future__ import annotations

from collections.abc import Callable

from eal_actors.actors.future import Future
from eal_actors.kernel.clock import Clock
from eal_actors.scenario.engine.cast import Task
from eal_actors.scenario.events import Event, RunPaused, RunResumed


class Pace:
    """Tells whether steps may begin. Everything happens in the loop's thread.

    Args:
        clock: the fleet's clock.
        tell: told of each event; makes it from the seconds since the run's start.
    """

    def __init__(self, clock: Clock, tell: Callable[[Callable[[float], Event]], float]) -> None:
        self._clock = clock
        self._tell = tell
        self._since_s: float | None = None
        self._paused_s = 0.0
        self._granted = 0
        self._granted_before = 0
        self._waiting: list[Future[None]] = []

    @property
    def is_paused(self) -> bool:
        """Whether nothing new is begun, single steps aside."""
        return self._since_s is not None

    @property
    def paused_s(self) -> float:
        """How long the run was paused so far, in seconds of the fleet's clock."""
        return self._paused_s + (self._clock.now() - self._since_s if self._since_s is not None else 0.0)

    def active_s(self) -> float:
        """Return a time that stands still while the run is paused."""
        return self._clock.now() - self.paused_s

    def pause(self) -> None:
        """Begin nothing new."""
        if self._since_s is None:
            self._since_s = self._clock.now()
            self._granted_before = self._granted
            self._tell(RunPaused)

    def resume(self) -> None:
        """Go on."""
        if self._since_s is not None:
            self._paused_s += self._clock.now() - self._since_s
            self._since_s = None
            self._tell(lambda time_s: RunResumed(time_s, is_single_step=False))
            self._wake()

    def step(self) -> None:
        """Let each line of steps begin one step; pauses a run that is not paused."""
        if self._since_s is None:
            self.pause()
            return
        self._granted += 1
        self._tell(lambda time_s: RunResumed(time_s, is_single_step=True))
        self._wake()

    def open_for_end(self) -> None:
        """Go on without a word, for the run is being stopped, and its end must not wait."""
        if self._since_s is not None:
            self._paused_s += self._clock.now() - self._since_s
            self._since_s = None
            self._wake()

    def _wake(self) -> None:
        waiting, self._waiting = self._waiting, []
        for future in waiting:
            future.set()

    def admits(self, task: Task) -> bool:
        """Return whether a line of steps may begin one now, and note that it does."""
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
