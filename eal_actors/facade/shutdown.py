"""Exit handlers: the robots of open fleets stop however the program ends.

SIGTERM and SIGHUP would end a process without running Python code, so a dropped connection would leave the motors
running. While a fleet is open they end the program as `sys.exit` does, and Ctrl-Z as Ctrl-C does, because a suspended
program could halt nothing. Handlers of the program's own are left alone.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType
from typing import Final, NoReturn

from eal_actors.kernel.errors import EALError, UnavailableError
from eal_actors.wire.engine_exit import IS_A_FORK  # whose exit handler runs after this module's

_actions: dict[Callable[[], None], Callable[[EALError], None]] = {}
_process_id = os.getpid()
"""The process that has the actions; another one in a child until `_leave_all` has run."""


def close_on_exit(close: Callable[[], None], leave: Callable[[EALError], None]) -> None:
    """Close something when the program exits. A forked child leaves it to its parent; `leave` gets the reason.

    Thread: any; signals are handled if it is the main thread.
    """
    _actions[close] = leave
    _replace_handlers(is_open=True)


def forget(close: Callable[[], None]) -> None:
    """Undo `close_on_exit`. Thread: any."""
    _actions.pop(close, None)
    if not _actions:
        _replace_handlers(is_open=False)


def is_to_close(close: Callable[[], None]) -> bool:
    """Return whether something is to be closed: neither has it been, nor is it the copy of a forked child.

    The copy has no threads, so that nothing of it would ever end. Thread: any.
    """
    return close in _actions


@atexit.register
def _close_all() -> None:
    with ExitStack() as stack:  # closes all of them even if one raises
        for close in _actions:
            stack.callback(close)


def _leave_all() -> None:
    """Leave everything to the parent. Thread: the only one of a child, where a lock may be held for ever."""
    global _process_id
    _process_id = os.getpid()
    _replace_handlers(is_open=False)
    for leave in _actions.values():
        leave(UnavailableError(IS_A_FORK))
    _actions.clear()


if hasattr(os, "register_at_fork"):  # the robots of a child are its parent's
    os.register_at_fork(after_in_child=_leave_all)


def _exit(number: int, _frame: FrameType | None) -> NoReturn:
    if os.getpid() != _process_id:  # an exception within a fork is ignored, and its signal would be lost
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)
    sys.exit(128 + number)


@contextmanager
def ends_call(action: Callable[[BaseException], None]) -> Iterator[None]:
    """Let Ctrl-C, SIGTERM and SIGHUP call an action with what they would raise, which may strike anywhere.

    Handlers other than Python's own and those of this module stay. Threads other than the main one see no signal.
    """
    owner, former = os.getpid(), {}

    def call(number: int, _frame: FrameType | None) -> None:
        if os.getpid() != owner:  # a fork, whose action is its parent's
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        action(KeyboardInterrupt() if number == signal.SIGINT else SystemExit(128 + number))

    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, *_SIGNALS):
            if signal.getsignal(number) in (signal.default_int_handler, _exit):
                former[number] = signal.signal(number, call)
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    signal.raise_signal(signal.SIGINT)


_HANDLERS: Final = {"SIGTERM": _exit, "SIGHUP": _exit, "SIGTSTP": _interrupt}
_SIGNALS: Final = tuple(one for one in signal.valid_signals() if getattr(one, "name", "") in _HANDLERS)
"""Signals that end or suspend a program; not every system has all."""


def _replace_handlers(*, is_open: bool) -> None:
    if threading.current_thread() is threading.main_thread():  # Python sets handlers in the main thread only
        for number in _SIGNALS:
            ours = _HANDLERS[signal.Signals(number).name]
            if is_open and signal.getsignal(number) == signal.SIG_DFL:
                signal.signal(number, ours)
            elif not is_open and signal.getsignal(number) == ours:
                signal.signal(number, signal.SIG_DFL)
