"""The calls of a fleet as they end: counted, and measured."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

from eal_actors.actors.call import Call, watch_calls
from eal_actors.actors.future import Future, Later
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import EALError

DONE = "done"
"""The outcome of a call that did not fail."""


class CallObserver:
    """Tells of each call of a fleet that ends, for the length of a `with` block.

    Args:
        clock: the fleet's clock, by which its calls are told from those of other fleets of this process.
        heard: called with the call, its outcome (`done`, or the code of its error) and its seconds of the fleet's
            clock from its making to its end. It must not block.

    Thread: any; `heard` runs in the thread that ends the call.
    """

    def __init__(self, clock: Clock, heard: Callable[[Call[Any], str, float], None]) -> None:
        self._clock = clock
        self._heard = heard
        self._end: Callable[[], None] = lambda: None

    def __enter__(self) -> Self:
        self._end = watch_calls(self._made)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._end()

    def _made(self, call: Call[Any]) -> None:
        if call.cell.clock is self._clock:
            made_s = self._clock.now()
            call.link(lambda done, later: self._ended(call, done, made_s, later))

    def _ended(self, call: Call[Any], done: Future[Any], made_s: float, _: Later | None) -> None:
        error = done.exception()
        outcome = DONE if error is None else error.code if isinstance(error, EALError) else EALError.code
        self._heard(call, outcome, self._clock.now() - made_s)
