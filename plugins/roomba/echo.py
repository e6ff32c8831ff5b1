"""The delay of a line, measured by the wheel speeds that the robot reports back."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

_MOST_SENT: Final = 64
_FIRST_PATIENCE_S: Final = 2.0
_PATIENCE_S: Final = 0.1
_SILENT_S: Final = 0.3


@dataclass
class _Sent:
    time_s: float
    speeds_mm_s: tuple[int, int]
    is_telling: bool = True  # not after a silence, which is no delay


class CommandEcho:
    """Compares the commanded wheel speeds with those that the robot reports as requested.

    A report that shows a command was made after it, so its delay is at most the time since then. While a command is
    not shown, the delay may have grown to the time since it was sent, or the command was lost.

    Attributes:
        delay_s: measured by the latest command that was shown; 0 until then.
    """

    def __init__(self) -> None:
        self.delay_s = 0.0
        self._sent: deque[_Sent] = deque(maxlen=_MOST_SENT)
        self._shown = (0, 0)
        self._heard_s = math.inf

    def sent(self, speeds_mm_s: tuple[int, int], now_s: float) -> None:
        """Record a command."""
        latest = self._sent[-1].speeds_mm_s if self._sent else self._shown
        if speeds_mm_s != latest:
            self._sent.append(_Sent(now_s, speeds_mm_s))

    def heard(self, speeds_mm_s: tuple[int, int], now_s: float) -> None:
        """Record a report of the requested speeds.

        Only a change shows a command: speeds that were reported before may be those of an earlier command.
        """
        if now_s - self._heard_s > _SILENT_S:
            for sent in self._sent:
                sent.is_telling = False
        self._heard_s = now_s
        before, self._shown = self._shown, speeds_mm_s
        for place, sent in enumerate(self._sent):
            is_shown = speeds_mm_s != before
            if sent.speeds_mm_s == speeds_mm_s and (is_shown or self._is_late(sent, now_s)):
                if is_shown and sent.is_telling:
                    self.delay_s = now_s - sent.time_s  # at most, if it was sent more than once
                for _ in range(place + 1):
                    self._sent.popleft()
                return

    @property
    def unshown(self) -> list[tuple[int, int]]:
        """The commands that no report has shown yet, the oldest first."""
        return [sent.speeds_mm_s for sent in self._sent]

    def lag_s(self, now_s: float) -> float:
        """Return by how much a report may be late now."""
        return max(self.delay_s, now_s - self._sent[0].time_s) if self._sent else self.delay_s

    def is_open(self, now_s: float) -> bool:
        """Return whether the latest command is not shown yet, and need not be."""
        return bool(self._sent) and not self.is_overdue(now_s)

    def is_overdue(self, now_s: float) -> bool:
        """Return whether the latest command should have been shown by now, and is not."""
        return bool(self._sent) and self._is_late(self._sent[-1], now_s)

    def _is_late(self, sent: _Sent, now_s: float) -> bool:
        return now_s - sent.time_s > (_PATIENCE_S + 2 * self.delay_s if self.delay_s else _FIRST_PATIENCE_S)
