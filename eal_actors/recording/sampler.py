"""Periodic sampling of resources through the resource API, so of any robot."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Self, TypeAlias

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.actors.many import read_many
from eal_actors.device.data import EALData
from eal_actors.kernel.clock import Clock, new_waiter
from eal_actors.kernel.log import get_logger

_ANSWER_S: Final = 1.0
"""Deadline of an answer in seconds of the fleet's clock, if the period is shorter."""
_ROUNDING_S: Final = 1e-9
_END_S: Final = 10.0
"""Real seconds for the final values. In lock step, code of a plugin runs in the sampler's thread, and may never end."""


class SampleSpec(NamedTuple):
    """A resource to sample, and the seconds of the fleet's clock between two samples."""

    resource: ResourceHandle
    period_s: float


SampleSink: TypeAlias = Callable[[ResourceHandle, EALData], bool]
"""Receives a value; returns False to end the sampling of its resource."""


class Sampler:
    """Samples resources inside its `with` block, and once more at the end; nothing before `from_s` of the clock.

    A resource that has not answered when it is due again is skipped until it has: sampling never delays a run. `sink`
    receives each value, with a time stamp that is not in the future: its own, else when it was asked for. If it raises,
    the resource is no longer sampled. Its thread is the sampler's own.
    """

    def __init__(self, clock: Clock, specs: Iterable[SampleSpec], sink: SampleSink, from_s: float = -math.inf) -> None:
        self._clock = clock
        self._sink = sink
        self._from_s = from_s
        groups: dict[float, list[_SampledResource]] = {}
        for resource, period_s in specs:
            groups.setdefault(period_s, []).append(_SampledResource(resource, max(period_s, _ANSWER_S)))
        self._groups = tuple(groups.items())
        self._stop = new_waiter()
        self._thread = threading.Thread(target=self._run, name="sampler", daemon=True)

    def __enter__(self) -> Self:
        self._clock.start(self._thread)
        return self

    def __exit__(self, *_exc_info: object) -> None:
        self._clock.wake(self._stop)
        with self._clock.outside():
            self._thread.join(_END_S)
        if self._thread.is_alive():
            get_logger().error("a resource is stuck while it is sampled: the last values are missing")
            for _, group in self._groups:
                for sampled in group:
                    sampled.is_wanted = False

    def _run(self) -> None:
        if not self._groups:
            return
        due_s = {period_s: self._first_s(period_s) for period_s, _ in self._groups}
        stopped = False
        while not stopped:
            now_s = self._clock.now()
            for period_s, group in self._groups:
                if now_s >= due_s[period_s] - _ROUNDING_S:
                    self._request(group)
                    due_s[period_s] = max(due_s[period_s] + period_s, now_s)
            stopped = self._clock.wait(self._stop, max(0.0, min(due_s.values()) - self._clock.now()))
            for _, group in self._groups:
                self._collect(group)
        for _, group in self._groups:
            self._request(group)  # the final values
        for _, group in self._groups:
            self._collect(group, wait=True)

    def _first_s(self, period_s: float) -> float:
        """Return the time of the first sample; summed up as in `_run`, so that it has the same last bit."""
        time_s = self._clock.now()
        while time_s < self._from_s:
            time_s += period_s
        return time_s

    def _request(self, group: Sequence[_SampledResource]) -> None:
        due = [sampled for sampled in group if sampled.is_wanted and sampled.answer is None]
        if due:
            answers = read_many([sampled.resource for sampled in due], due[0].timeout_s)  # a group has one period
            asked_s = self._clock.now()
            for sampled, answer in zip(due, answers, strict=True):
                sampled.answer, sampled.asked_s = answer, asked_s

    def _collect(self, group: Sequence[_SampledResource], *, wait: bool = False) -> None:
        for sampled in group:
            answer = sampled.answer
            if answer is None or not (answer.done() or wait):
                continue
            sampled.answer = None
            if answer.exception() is None and sampled.is_wanted:
                self._pass_on(sampled, answer.get())

    def _pass_on(self, sampled: _SampledResource, data: EALData) -> None:
        """Pass a value to the sink. One robot's strange values must not end the sampling of others."""
        now_s = self._clock.now()
        if data.stamp_s is None:  # answers are collected up to a period later
            data = data.with_meta(stamp_s=sampled.asked_s)
        elif data.stamp_s > now_s:  # the robot's clock is ahead, or it lies
            data = data.with_meta(stamp_s=now_s)
        try:
            sampled.is_wanted = self._sink(sampled.resource, data)
        except Exception:  # noqa: BLE001  # whatever a value from the network makes a sink raise
            sampled.is_wanted = False
            get_logger(robot=sampled.resource.robot).exception(
                "its values are no longer sampled", resource=sampled.resource.name
            )


@dataclass
class _SampledResource:
    """A resource and its pending answer."""

    resource: ResourceHandle
    timeout_s: float
    answer: Future[EALData] | None = None
    asked_s: float = 0.0
    is_wanted: bool = True
