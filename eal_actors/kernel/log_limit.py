"""LogLimit: a bound on log lines that others cause, so that a flood of messages fills no disk."""

from __future__ import annotations

import threading
from collections import deque
from typing import Final

from eal_actors.kernel.clock import REAL_TIME


class LogLimit:
    """Admits some lines in each period of real time, and counts the others. Thread: any."""

    def __init__(self, most: int = 10, period_s: float = 10.0) -> None:
        self._period_s: Final = period_s
        self._times_s: deque[float] = deque(maxlen=most)
        self._omitted = 0
        self._lock = threading.Lock()

    def admit(self) -> dict[str, int] | None:
        """Return further fields for a line that may be written, such as `omitted`; None for one that must not."""
        now_s = REAL_TIME.now()
        with self._lock:
            is_full = len(self._times_s) == self._times_s.maxlen
            if is_full and now_s - self._times_s[0] < self._period_s:
                self._omitted += 1
                return None
            self._times_s.append(now_s)
            omitted, self._omitted = self._omitted, 0
        return {"omitted": omitted} if omitted else {}
