"""Signals that end the program; of a run, the first stops it in good order, the second hurries, the third leaves."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType
from typing import Any, Final, NoReturn, Self, TypeVar

from eal_actors.actors.future import Future
from eal_actors.cli.output import stderr
from eal_actors.scenario import Run

T = TypeVar("T")

_SAID: Final = (
    "Stopping: the robots halt, then the steps of `finally` follow; Ctrl-C skips those.",
    "Stopping at once; Ctrl-C again leaves everything as it is.",
)
_HANGUPS: Final = tuple(number for number in signal.valid_signals() if getattr(number, "name", "") == "SIGHUP")
"""The terminal was closed: one signal, or none where the system has no such thing."""


def heed_signals() -> None:
    """Have SIGTERM and a closed terminal count as Ctrl-C, so that every `finally` stops its motors."""
    for number in (signal.SIGTERM, *_heeded_hangups()):
        signal.signal(number, _interrupt)


def _heeded_hangups() -> list[int]:
    return [number for number in _HANGUPS if signal.getsignal(number) is not signal.SIG_IGN]  # as `nohup` sets it


def _ignore_further(number: int) -> None:
    """Take a closed terminal for one signal: the kernel and the shell both tell of it, and nobody is in a hurry."""
    if number in _HANGUPS:
        signal.signal(number, signal.SIG_IGN)


def _interrupt(number: int, _frame: FrameType | None) -> NoReturn:
    _ignore_further(number)
    raise KeyboardInterrupt


class Interrupts:
    """Handles the signals for the length of a `with` block, in the main thread.

    Args:
        run: the run that is aborted: the first signal halts the robots and lets `finally` go on, the second skips
            that. A third raises KeyboardInterrupt, which leaves the block.

    Attributes:
        count: how many signals came.
    """

    def __init__(self, run: Run) -> None:
        self.count = 0
        self._run = run
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        for number in (signal.SIGINT, signal.SIGTERM, *_heeded_hangups()):
            self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            if signal.getsignal(number) == self._handle:  # further hang-ups stay ignored
                signal.signal(number, handler)

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        _ignore_further(number)
        if self.count and number in _HANGUPS:  # stopping already; nobody asked to skip `finally`
            return
        self.count += 1
        if self.count > 2:
            raise KeyboardInterrupt
        self._run.abort(f"interrupted by {signal.Signals(number).name}")  # first: what follows may fail
        stderr().print(_SAID[self.count - 1], style="yellow")

    def wait(self, future: Future[T]) -> T:
        """Return what the run comes to.

        Raises:
            KeyboardInterrupt: at the third signal.

        Thread: blocks the main thread.
        """
        return future.get()
