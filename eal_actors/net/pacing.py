"""Pace: how far a session's calls may run ahead of their answers.

A process that serves a thousand robots takes the commands to them one by one. What waits in its socket meanwhile gets
older, and a command that is too old is refused. So the sender waits for answers once many are due; only as long as
answers do come, for a command that takes long is answered late, and a robot that is frozen not at all.
"""

from __future__ import annotations

import threading
from typing import Final

from eal_actors.kernel.clock import REAL_TIME, new_waiter

WINDOW: Final = 256
"""Calls that may be unanswered before the sender waits."""

_ENOUGH: Final = 128
"""As many as that are unanswered when it goes on: many are sent together at less cost than one by one."""

PATIENCE_S: Final = 0.05
"""Real seconds without any answer, after which what is due is taken to be slow, and holds nobody up any more."""


class Pace:
    """Counts the calls of one session that are unanswered. Thread: any, but for `keep`."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._due = 0
        self._slow = 0
        self._is_waiting = False
        self._waiter = new_waiter()

    @property
    def is_idle(self) -> bool:
        """Whether every call is answered, so that none waits for a link either."""
        return self._due == 0

    def sent(self) -> None:
        """Note that a call leaves."""
        with self._lock:
            self._due += 1

    def answered(self) -> None:
        """Note that a call is answered, or never will be."""
        with self._lock:
            self._due -= 1
            self._slow = min(self._slow, self._due)
            is_enough = self._is_waiting and self._due - self._slow <= _ENOUGH
        if is_enough:
            REAL_TIME.wake(self._waiter)

    def keep(self) -> None:
        """Wait while too many calls are unanswered. Thread: the sender's; blocks it as long as answers come."""
        if self._due - self._slow < WINDOW:  # as it mostly is
            return
        self._is_waiting = True
        while (due := self._due) - self._slow > _ENOUGH:
            if not REAL_TIME.wait(self._waiter, PATIENCE_S) and self._due >= due:
                with self._lock:
                    self._slow = self._due
        self._is_waiting = False
