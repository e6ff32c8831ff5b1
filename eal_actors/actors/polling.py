"""PolledFeed: asks a resource of this process for its value, again and again."""

from __future__ import annotations

import math
from typing import Final

from eal_actors.actors.call import Call, ResourceCell
from eal_actors.actors.feeds import Sink, StreamSpec
from eal_actors.actors.future import Future
from eal_actors.device.data import EALData
from eal_actors.kernel.errors import EALError, ResourceFaultError, shown

_PATIENCE_S: Final = 30.0
"""Real seconds that a value may take: nobody waits for a single one, so only a resource that hangs is to be restarted
for being late, not a camera that is slow on a busy machine."""
_LOST_S: Final = 2.0
"""Seconds beyond a period after which a question that a faulty link has not brought an answer to counts as lost."""


class PolledFeed:
    """Asks by ordinary get_value calls, one at a time, which wait in the resource's mailbox like all others.

    The questions keep to a grid of whole periods from the first one. Where an answer takes longer than a period, the
    questions that would have come meanwhile are left out, so that a slow resource is never swamped.

    Args:
        cell: the slot of the resource.
        spec: what is wanted.
        sink: where the values go.

    Thread: the timekeeper's and the resource's.
    """

    def __init__(self, cell: ResourceCell, spec: StreamSpec, sink: Sink) -> None:
        self._cell = cell
        self._spec = spec
        self._sink = sink
        self._start_s = cell.clock.now()
        self._count = 0
        self._is_closed = False
        self._timeout_s = max(cell.timeout_s, cell.clock.of_real(_PATIENCE_S))
        self._timer = cell.timekeeper.call_at(self._start_s, self._ask)

    def close(self) -> None:
        """See Feed."""
        self._is_closed = True
        self._timer.cancel()

    def _ask(self) -> None:
        if self._is_closed:
            return
        call: Call[EALData] = Call(self._cell, "get_value", (), self._timeout_s)
        self._cell.submit(call)
        if self._cell.link.is_faulty:
            self._cell.timekeeper.call_later(self._spec.period_s + _LOST_S, call.expire)
        call.add_done_callback(self._take)

    def _take(self, call: Future[EALData]) -> None:
        if self._is_closed:
            return
        now_s = self._cell.clock.now()
        error = call.exception()
        if error is None:
            self._sink.offer(self._checked(call.get(), now_s))
        else:
            self._sink.offer(error if isinstance(error, EALError) else ResourceFaultError(shown(error)))
        elapsed = math.floor((now_s - self._start_s) / self._spec.period_s)
        self._count = max(self._count, elapsed) + 1
        self._timer = self._cell.timekeeper.call_at(self._start_s + self._count * self._spec.period_s, self._ask)
        if self._is_closed:  # just now, by another thread, which has called off the timer before
            self._timer.cancel()

    def _checked(self, data: EALData, now_s: float) -> EALData | EALError:
        """Return the value with a time, or why it cannot travel as it is wanted."""
        try:
            self._spec.check_value(data)
        except EALError as error:
            return error.at(self._cell.robot, self._cell.name)
        return data if data.stamp_s is not None else data.with_meta(stamp_s=now_s)
