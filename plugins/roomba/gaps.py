"""Travel that was lost with a reply: each reading resets the counters of the Serial Command Interface."""

from __future__ import annotations

import math
from typing import Final, TypeAlias

Pair: TypeAlias = tuple[float, float]
"""Of the left and the right wheel."""

_NOISE_M: Final = 0.004  # tolerance of the counts of two wheels
_ACCELERATION_M_S2: Final = 0.8  # about that of a Roomba's wheels


class TravelGaps:
    """Estimates the travel between two replies when the replies in between were lost.

    A lost reply has reset the counters; a lost request has not. The count of the next reply decides which it was: it
    fits best the possible travel since one of the requests. The wheels either kept their speeds or accelerated to the
    commanded ones.

    Attributes:
        doubt_m: error bound of all estimates, 0 or more.
    """

    def __init__(self) -> None:
        self.doubt_m = 0.0
        self._answered_s = 0.0
        self._speeds_m_s: Pair = (0.0, 0.0)
        self._unanswered_s: list[float] = []

    def ask(self, now_s: float) -> None:
        """Record a request of the sensors."""
        self._unanswered_s.append(now_s)

    def answer(self, counted_m: Pair, commanded_m_s: Pair) -> Pair:
        """Return the travel to add to the count of the latest reply: 0 if no reply was lost.

        Args:
            counted_m: the count.
            commanded_m_s: the last commanded speeds.
        """
        if not self._unanswered_s:
            return 0.0, 0.0
        *between_s, now_s = self._unanswered_s
        fits = [
            (self._misfit_m(since_s, now_s, target, counted_m), place, since_s, target)
            for place, since_s in enumerate((self._answered_s, *between_s))
            for target in (commanded_m_s, self._speeds_m_s)
        ]
        misfit_m, _, since_s, target = min(fits)  # of equal fits the first: no loss
        missing = self._travel_m(since_s - self._answered_s, target)
        others = (self._travel_m(fit[2] - self._answered_s, fit[3]) for fit in fits if fit[0] <= misfit_m + _NOISE_M)
        self.doubt_m += max(abs(other[0] - missing[0]) + abs(other[1] - missing[1]) for other in others) / 2
        self.doubt_m += misfit_m / 2 if between_s else 0.0
        if (duration_s := now_s - since_s) > 0:
            self._speeds_m_s = counted_m[0] / duration_s, counted_m[1] / duration_s
        self._answered_s, self._unanswered_s = now_s, []
        return missing

    def _misfit_m(self, since_s: float, now_s: float, target: Pair, counted_m: Pair) -> float:
        until_now, until_then = (self._travel_m(at_s - self._answered_s, target) for at_s in (now_s, since_s))
        return sum(
            abs(after - before - counted)
            for after, before, counted in zip(until_now, until_then, counted_m, strict=True)
        )

    def _travel_m(self, duration_s: float, target: Pair) -> Pair:
        """Return the travel of the wheels in a time from the latest reading, if they accelerate to target speeds."""
        left, right = (
            _ramp_m(before, after, duration_s) for before, after in zip(self._speeds_m_s, target, strict=True)
        )
        return left, right


def _ramp_m(speed_m_s: float, target_m_s: float, duration_s: float) -> float:
    lack_m_s = target_m_s - speed_m_s
    ramp_s = min(duration_s, abs(lack_m_s) / _ACCELERATION_M_S2)
    ramp_m = speed_m_s * ramp_s + math.copysign(_ACCELERATION_M_S2 * ramp_s**2 / 2, lack_m_s)
    return ramp_m + target_m_s * (duration_s - ramp_s)
