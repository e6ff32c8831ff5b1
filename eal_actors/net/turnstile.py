"""Turnstile: one thread at a time sends, and those that come meanwhile leave their work to it.

A session's messages go through one place anyway. Where a hundred threads push into it at once, they mostly wake one
another up; that costs more than sending does.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable


class Turnstile:
    """Lets work pass in the order in which it came. Thread: any; the work must not raise."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._left: deque[Callable[[], None]] = deque()

    def leave(self, work: Callable[[], None]) -> None:
        """Have it done: by this thread, or, without waiting, by the one that is at it."""
        self._left.append(work)
        self._do_what_is_left()

    def enter(self, work: Callable[[], None]) -> None:
        """Do it in this thread, after whoever is at it. Thread: waits for that one."""
        with self._lock:
            work()
        self._do_what_is_left()

    def _do_what_is_left(self) -> None:
        while self._left and self._lock.acquire(blocking=False):  # again: something may come just before the release
            try:
                while self._left:
                    self._left.popleft()()
            finally:
                self._lock.release()
