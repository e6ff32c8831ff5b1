"""SIGINT and SIGTERM during a run: the first stops it in good order, the second hurries, the third leaves."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType
from typing import Any, Final, Self, TypeVar

from eal_actors.actors.future import Future
from eal_actors.cli.output import stderr
from eal_actors.scenario import Run

T = TypeVar("T")

_SAID: Final = (
    "Stopping: the robots halt, then the steps of `finally` follow; Ctrl-C skips those.",
    "Stopping at once; Ctrl-C again leaves everything as it is.",
)
_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


class Interrupts:
    """Handles both signals for the length of a `with` block, in the main thread.

    Args:
        run: the run that is aborted: the first signal halts the robots and lets `finally` go on, the second skips
            that. A third raises KeyboardInterrupt, which leaves the block.

    Attributes:
        count: how many signals came.
    """

    def __init__(self, run: Run) -> None:
        self.count = 0
        self._run = run
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        for number in _SIGNALS:
            self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        self.count += 1
        if self.count > 2:
            raise KeyboardInterrupt
        stderr().print(_SAID[self.count - 1], style="yellow")
        self._run.abort(f"interrupted by {signal.Signals(number).name}")

    def wait(self, future: Future[T]) -> T:
        """Return what the run comes to.

        Raises:
            KeyboardInterrupt: at the third signal.

        Thread: blocks the main thread.
        """
        return future.get()
