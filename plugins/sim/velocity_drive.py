"""A wheel motion by target speeds."""

from __future__ import annotations

import math

from typing_extensions import override

from .models import Make
from .motion import RegularMotion, WheelMotion


class VelocityDrive(WheelMotion):
    """The wheels follow target speeds with the make's acceleration. Targets of 0 end the motion.

    Args:
        speeds_m_s: initial speeds of the left and the right wheel.
        hold_s: the targets become 0 after this time; None for never.
    """

    def __init__(
        self,
        make: Make,
        speeds_m_s: tuple[float, float],
        targets_m_s: tuple[float, float],
        hold_s: float | None,
        tick_s: float,
    ) -> None:
        self._acceleration = make.acceleration_m_s2
        self._left_m_s, self._right_m_s = speeds_m_s
        self._targets_m_s = targets_m_s
        self._tick_s = tick_s
        self._hold_ticks = math.inf if hold_s is None else round(hold_s / tick_s)

    @property
    @override
    def remaining_s(self) -> float:
        if self._targets_m_s == (0.0, 0.0):
            fastest_m_s = max(abs(self._left_m_s), abs(self._right_m_s))
            ticks = math.ceil(fastest_m_s / (self._acceleration * self._tick_s) - 1e-9)
            return max(ticks, 1 if fastest_m_s else 0) * self._tick_s  # a rounding error of a speed takes a tick too
        return self._hold_ticks * self._tick_s

    @property
    @override
    def is_over(self) -> bool:
        return self._targets_m_s == (0.0, 0.0) and self._left_m_s == self._right_m_s == 0.0

    @override
    def step(self) -> tuple[float, float]:
        left_target, right_target = self._targets_m_s
        if self._left_m_s == left_target and self._right_m_s == right_target and self._hold_ticks > 1:
            self._hold_ticks -= 1
            return left_target * self._tick_s, right_target * self._tick_s
        left_m, self._left_m_s = self._follow(self._left_m_s, left_target)
        right_m, self._right_m_s = self._follow(self._right_m_s, right_target)
        self._hold_ticks -= 1
        if self._hold_ticks <= 0:
            self._targets_m_s = (0.0, 0.0)
        return left_m, right_m

    @override
    def regular(self) -> RegularMotion | None:
        left_m_s, right_m_s = self._targets_m_s
        if self._left_m_s != left_m_s or self._right_m_s != right_m_s:
            return None
        return RegularMotion(self._hold_ticks - 1, 0.0, left_m_s * self._tick_s, right_m_s * self._tick_s)

    @override
    def skip(self, ticks: int, travelled_m: float) -> None:
        self._hold_ticks -= ticks

    @property
    def speeds_m_s(self) -> tuple[float, float]:
        """The current speeds of the left and the right wheel."""
        return self._left_m_s, self._right_m_s

    def _follow(self, speed_m_s: float, target_m_s: float) -> tuple[float, float]:
        """Return the travel in a tick and the speed after it."""
        change = target_m_s - speed_m_s
        ramp_s = abs(change) / self._acceleration
        if ramp_s <= self._tick_s:
            return target_m_s * self._tick_s - change * ramp_s / 2, target_m_s
        gain = math.copysign(self._acceleration * self._tick_s, change)
        return (speed_m_s + gain / 2) * self._tick_s, speed_m_s + gain
