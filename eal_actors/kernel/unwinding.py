"""Exceptions raised in other threads, and code that they must not interrupt.

CPython raises such an exception after whatever call the thread makes next. If that call is `lock.acquire()`, the thread
has the lock and never releases it. `with lock` has no such gap, but libraries' code has: the handlers of `logging`
before Python 3.13. One lost lock of a handler stops every thread of the process that logs.

The order is safe because `raise_in` sets the exception under the same lock: a thread that has acquired it raises what
was set before at its first call inside, and nothing more can be set until it has entered.
"""

from __future__ import annotations

import ctypes
import os
import threading
from types import TracebackType
from typing import Final

_LOCK: Final = threading.Lock()
_INSIDE: Final[set[int]] = set()  # the threads in an uninterrupted block
_DUE: Final[dict[int, type[BaseException]]] = {}  # the exceptions that those threads raise at the end of the block

if hasattr(os, "register_at_fork"):  # a child would lack the thread that holds the lock
    os.register_at_fork(before=_LOCK.acquire, after_in_parent=_LOCK.release, after_in_child=_LOCK.release)


class AbandonedThread(BaseException):
    """Raised inside the thread of a stuck actor that was abandoned, to unwind it."""


def raise_in(thread: threading.Thread, error: type[BaseException]) -> None:
    """Raise an exception in a thread: at its next call, or at the end of its uninterrupted block.

    Thread: any other; does not block.
    """
    with _LOCK:
        ident = thread.ident
        if ident is None or not thread.is_alive():
            return
        if ident in _INSIDE:
            _DUE[ident] = error
        else:
            ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(ident), ctypes.py_object(error))


class Uninterrupted:
    """A block that no exception of `raise_in` interrupts. It may hold another such block. For short code alone.

    The end of the outermost block raises the BaseException that `raise_in` was given meanwhile.
    """

    def __init__(self) -> None:
        self._ident: int | None = None

    def __enter__(self) -> None:
        with _LOCK:
            ident = threading.get_ident()  # the first call inside: an exception that was set before is raised here
            if ident not in _INSIDE:
                self._ident = ident
                _INSIDE.add(ident)

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        if self._ident is None:  # the outer block goes on
            return
        with _LOCK:
            _INSIDE.discard(self._ident)
            due = _DUE.pop(self._ident, None)
        if due is not None:
            raise due
