"""Signals that end the program.

During a run, the first signal stops the run and still executes `finally`; the second skips `finally`; the third
disconnects the robots; one more ends the program at once. The exit code is 130 in each case.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import TYPE_CHECKING, Any, Final, NoReturn, Self

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.output import stderr

if TYPE_CHECKING:
    from eal_actors.scenario import Run

_MESSAGES: Final = (
    "Stopping: the robots halt, then the steps of `finally` run; Ctrl-C skips them.",
    "Stopping now, without `finally`; Ctrl-C again disconnects the robots.",
    "Disconnecting the robots; Ctrl-C again ends the program at once.",
)
_HANGUPS: Final = tuple(number for number in signal.valid_signals() if getattr(number, "name", "") == "SIGHUP")
"""SIGHUP, sent when the terminal closes; empty on a system without it."""

_was_interrupted = False
"""Whether a signal has raised KeyboardInterrupt, which the code of others may have dropped, as OpenCV's import does."""


def was_interrupted() -> bool:
    """Return whether a signal has interrupted the program, even if its KeyboardInterrupt was dropped or replaced."""
    return _was_interrupted


def handle_signals() -> None:
    """Make SIGINT, SIGTERM and SIGHUP raise KeyboardInterrupt, so that every `finally` stops its motors."""
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, _interrupt)
    for number in (signal.SIGTERM, *_handled_hangups()):
        signal.signal(number, _interrupt)


def reload_at_hangup(reload: Callable[[], None]) -> None:
    """Make SIGHUP run a function in a thread of its own, unless it comes from a terminal that has closed."""
    terminals = [number for number in range(3) if os.isatty(number)]

    def handle(number: int, frame: FrameType | None) -> None:
        if all(map(os.isatty, terminals)):
            threading.Thread(target=reload, name="reload", daemon=True).start()
        else:
            _interrupt(number, frame)

    for number in _handled_hangups():
        signal.signal(number, handle)


def _handled_hangups() -> list[int]:
    return [number for number in _HANGUPS if signal.getsignal(number) is not signal.SIG_IGN]  # `nohup` ignores it


def _ignore_repeated_hangups(number: int) -> None:
    """Ignore further hang-ups after the first: the kernel and the shell both send one when a terminal closes."""
    if number in _HANGUPS:
        signal.signal(number, signal.SIG_IGN)


def _interrupt(number: int, _frame: FrameType | None) -> NoReturn:
    global _was_interrupted
    _was_interrupted = True
    _ignore_repeated_hangups(number)
    raise KeyboardInterrupt


class RunInterrupts:
    """Signal handlers during a run, set for the length of a `with` block in the main thread.

    The third signal raises KeyboardInterrupt in the block. After the block, the first one raises it, unless there was a
    signal in the block.
    """

    def __init__(self, run: Run) -> None:
        self.count = 0
        self._run = run
        self._before: dict[int, Any] = {}
        self._is_over = False
        self._has_raised = False

    def __enter__(self) -> Self:
        if _was_interrupted:
            raise KeyboardInterrupt
        for number in (signal.SIGINT, signal.SIGTERM, *_handled_hangups()):
            self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *_exc_info: object) -> None:
        self._is_over = True
        for number, handler in self._before.items() if not self.count else ():  # an interrupted program is ending
            if signal.getsignal(number) == self._handle:  # further hang-ups stay ignored
                signal.signal(number, handler)

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        _ignore_repeated_hangups(number)
        if self.count and number in _HANGUPS:  # already stopping, and a hang-up is no request to skip `finally`
            return
        if self._has_raised:  # a second KeyboardInterrupt would break the handling of the first, and the exit code
            os._exit(ExitCode.INTERRUPTED)
        self.count += 1
        if self.count > 2 or self._is_over:
            self._has_raised = True
            stderr().print(_MESSAGES[2], style="yellow")
            raise KeyboardInterrupt
        self._run.abort(f"interrupted by {signal.Signals(number).name}")  # first: the message may fail
        stderr().print(_MESSAGES[self.count - 1], style="yellow")
