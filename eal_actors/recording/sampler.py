"""Ask resources for their values again and again while robots work, through the resource API, so for any robot."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from types import TracebackType
from typing import Final, NamedTuple, Self, TypeAlias

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.data import EALData
from eal_actors.kernel.clock import Clock, new_waiter

_ANSWER_S: Final = 1.0
"""How long an answer may take, if that is longer than the period, in seconds of the fleet's clock."""
_ROUNDING_S: Final = 1e-9


class Wish(NamedTuple):
    """A resource to ask, and how many seconds of the fleet's clock lie between two of its samples."""

    resource: ResourceHandle
    period_s: float


Take: TypeAlias = Callable[[ResourceHandle, EALData], bool]
"""Keeps a value; False means that the resource is asked no more."""


class Sampler:
    """Asks between `with` and its end, and once more at the end.

    What has not answered when it is due again is passed over until it has: sampling never holds up a run.

    Args:
        clock: the fleet's clock.
        wishes: what to ask.
        take: called with each value, in the sampler's own thread.
    """

    def __init__(self, clock: Clock, wishes: Iterable[Wish], take: Take) -> None:
        self._clock = clock
        self._take = take
        groups: dict[float, list[_Asked]] = {}
        for resource, period_s in wishes:
            groups.setdefault(period_s, []).append(_Asked(resource, max(period_s, _ANSWER_S)))
        self._groups = tuple(groups.items())
        self._stop = new_waiter()
        self._thread = threading.Thread(target=self._sample, name="sampler", daemon=True)

    def __enter__(self) -> Self:
        self._clock.start(self._thread)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._clock.wake(self._stop)
        with self._clock.outside():
            self._thread.join()

    def _sample(self) -> None:
        if not self._groups:
            return
        due_s = dict.fromkeys((period_s for period_s, _ in self._groups), self._clock.now())
        stopped = False
        while not stopped:
            now_s = self._clock.now()
            for period_s, group in self._groups:
                if now_s >= due_s[period_s] - _ROUNDING_S:
                    self._ask(group)
                    due_s[period_s] = max(due_s[period_s] + period_s, now_s)
            stopped = self._clock.wait(self._stop, max(0.0, min(due_s.values()) - self._clock.now()))
            for _, group in self._groups:
                self._note(group)
        for _, group in self._groups:
            self._ask(group)  # where everybody ended up
        for _, group in self._groups:
            self._note(group, wait=True)

    def _ask(self, group: Sequence[_Asked]) -> None:
        for asked in group:
            if asked.is_wanted and asked.answer is None:
                asked.answer = asked.resource.get_value(timeout_s=asked.timeout_s)

    def _note(self, group: Sequence[_Asked], *, wait: bool = False) -> None:
        for asked in group:
            answer = asked.answer
            if answer is None or not (answer.done() or wait):
                continue
            asked.answer = None
            if answer.exception() is None:
                asked.is_wanted = self._take(asked.resource, answer.get())


class _Asked:
    """A resource, and its answer that is still to come."""

    def __init__(self, resource: ResourceHandle, timeout_s: float) -> None:
        self.resource = resource
        self.timeout_s = timeout_s
        self.answer: Future[EALData] | None = None
        self.is_wanted = True
