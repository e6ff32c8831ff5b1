"""However a program ends, its robots stop: SIGTERM and SIGHUP are made to end it as `sys.exit` does.

Left alone, they end a process without another line of Python: a dropped connection would leave the motors running.
"""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType
from typing import Final, NoReturn

_SIGNALS: Final = (signal.SIGTERM, signal.SIGHUP)


def _exit(number: int, _frame: FrameType | None) -> NoReturn:
    sys.exit(128 + number)


def end_in_good_order() -> None:
    """Let both signals unwind the program, where it has not chosen otherwise. Thread: any; works in the main thread."""
    _replace(signal.SIG_DFL, _exit)


def end_as_before() -> None:
    """Undo `end_in_good_order`. Thread: any; works in the main thread."""
    _replace(_exit, signal.SIG_DFL)


def _replace(before: object, after: object) -> None:
    if threading.current_thread() is threading.main_thread():  # only there may handlers be set
        for number in _SIGNALS:
            if signal.getsignal(number) == before:
                signal.signal(number, after)  # type: ignore[arg-type]  # one of the two values above
