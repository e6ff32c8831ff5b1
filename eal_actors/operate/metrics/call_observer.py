"""Observation of a fleet's calls: their outcomes and durations."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from eal_actors.actors.call import Call, watch_calls
from eal_actors.actors.future import CallSoon, Future
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import code_of

DONE = "done"
"""The outcome of a call that did not fail."""


@contextmanager
def observe_calls(clock: Clock, on_end: Callable[[Call[Any], str, float], None]) -> Iterator[None]:
    """Call back at the end of each call of a fleet, for the length of a `with` block.

    Args:
        clock: the fleet's clock, to tell its calls apart from those of other fleets.
        on_end: receives the call, its outcome (`done` or an error code), and its duration in seconds of the fleet's
            clock. Called in the thread that ends the call; it must not block.
    """

    def on_call(call: Call[Any]) -> None:
        if call.cell.clock is clock:
            start_s = clock.now()
            call.link(lambda done, later: on_done(call, done, start_s, later))

    def on_done(call: Call[Any], done: Future[Any], start_s: float, _: CallSoon | None) -> None:
        error = done.exception()
        on_end(call, DONE if error is None else code_of(error), clock.now() - start_s)

    stop = watch_calls(on_call)
    try:
        yield
    finally:
        stop()
