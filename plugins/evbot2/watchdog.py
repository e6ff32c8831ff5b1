"""The time of silence after which a base stops, derived from measured round trips."""

from __future__ import annotations

from collections import deque
from typing import Final

LEAST_S: Final = 0.5
MOST_S: Final = 2.0
"""A base at full speed drives this long when its computer dies: the limit of what a slow computer may ask for."""
POLLS: Final = 3
"""A watchdog time is at least this many polls."""

_MARGIN: Final = 3.0
_KEPT: Final = 64


class WatchdogTime:
    """The watchdog time of a session.

    It is `_MARGIN` times the worst of the last measured round trips and intervals of polls, within LEAST_S and MOST_S,
    so that a busy computer or a slow network does not stop the base by mistake. It rises at once, and falls when half
    of it is enough.

    Args:
        fixed_s: from the settings; None to derive it.
        period_s: interval of polls.

    Attributes:
        agreed_s: the time that the base has last confirmed, or will be greeted with.
    """

    def __init__(self, fixed_s: float | None, period_s: float) -> None:
        self._fixed_s = fixed_s
        self._least_s = max(LEAST_S, POLLS * period_s)
        self._measured_s: deque[float] = deque(maxlen=_KEPT)
        self.agreed_s = fixed_s or self._least_s

    def measure(self, duration_s: float) -> None:
        """Note the duration of a round trip, or the interval of two polls."""
        self._measured_s.append(duration_s)

    def due_s(self) -> float | None:
        """Return the time to ask the base for; None if the agreed one is right."""
        if self._fixed_s is not None:
            return None
        wanted_s = min(max(_MARGIN * max(self._measured_s, default=0.0), self._least_s), max(MOST_S, self._least_s))
        return wanted_s if wanted_s > self.agreed_s or wanted_s < self.agreed_s / 2 else None
