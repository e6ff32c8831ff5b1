"""Rules for restarting a child that crashed, and for giving up, in Elixir's vocabulary."""

from __future__ import annotations

import enum
from collections import deque
from dataclasses import dataclass, field


class Restart(enum.Enum):
    """When a child is restarted."""

    PERMANENT = "permanent"
    """Always, also after a normal end."""
    TRANSIENT = "transient"
    """Only after a crash."""
    TEMPORARY = "temporary"
    """Never."""

    def applies(self, *, crashed: bool) -> bool:
        """Return whether a child is started again after it ended."""
        return self is Restart.PERMANENT or (self is Restart.TRANSIENT and crashed)


@dataclass(frozen=True, slots=True)
class BackOff:
    """The delay before the next restart: `initial_s * factor ** n`, at most `longest_s`."""

    initial_s: float = 0.1
    factor: float = 2.0
    longest_s: float = 5.0

    def delay_s(self, restarts: int) -> float:
        """Return the delay after that many restarts in a row."""
        return min(self.initial_s * self.factor**restarts, self.longest_s)


@dataclass
class RestartIntensity:
    """One-for-one supervision: at most `max_restarts` restarts within `window_s` for all children together.

    `window_s` is in seconds.
    """

    max_restarts: int = 3
    window_s: float = 5.0
    back_off: BackOff = field(default_factory=BackOff)
    _restarts_at_s: deque[float] = field(default_factory=deque)

    def next_delay_s(self, now_s: float) -> float | None:
        """Record a restart at `now_s`; return the delay before it, or None when it is one too many."""
        while self._restarts_at_s and self._restarts_at_s[0] <= now_s - self.window_s:
            self._restarts_at_s.popleft()
        if len(self._restarts_at_s) >= self.max_restarts:
            return None
        delay_s = self.back_off.delay_s(len(self._restarts_at_s))
        self._restarts_at_s.append(now_s)
        return delay_s
