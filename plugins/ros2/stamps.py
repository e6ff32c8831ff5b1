"""StampOffset: times of a robot's clock in seconds of the fleet's clock."""

from __future__ import annotations

from collections import deque
from typing import Final

_KEPT: Final = 50
"""Messages whose delays are compared. The least of them is the offset of the clocks and the least delay together."""


class StampOffset:
    """Translates the times of one publisher, whose clock is another one; no clock needs to be set.

    Thread: one at a time.
    """

    def __init__(self) -> None:
        self._differences_s: deque[float] = deque(maxlen=_KEPT)

    def fleet_s(self, stamp_s: float, now_s: float) -> float:
        """Return the fleet's time of a publisher's stamp: at the latest `now_s`, when the message arrived."""
        self._differences_s.append(now_s - stamp_s)
        return min(now_s, stamp_s + min(self._differences_s))
