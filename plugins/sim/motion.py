"""Motions: what the wheels of a robot are commanded to travel, cut into physics ticks.

A motion's duration is known beforehand, for the encoders count what was commanded: a robot that pushes a wall ends its
motion too. Everything here is pure and counts in ticks; no clock is read.
"""

from __future__ import annotations

import math
from typing import Final, Protocol

from eal_actors.plugin import WheelCalibration

from .models import Make

NOMINAL: Final = WheelCalibration()
"""Of wheels that are believed to be just as they should be."""


class Trapezoid:
    """Travel over time: speed up evenly, cruise, slow down evenly; a triangle where the length is short.

    Args:
        length_m: travel, 0 or more.
        speed_m_s: cruising speed, over 0.
        acceleration_m_s2: over 0.
    """

    def __init__(self, length_m: float, speed_m_s: float, acceleration_m_s2: float) -> None:
        self.length_m = length_m
        self._acceleration = acceleration_m_s2
        self._peak = min(speed_m_s, math.sqrt(length_m * acceleration_m_s2))
        self._ramp_s = self._peak / acceleration_m_s2
        cruise_s = length_m / self._peak - self._ramp_s if length_m else 0.0
        self.duration_s = 2 * self._ramp_s + cruise_s

    def travelled_m(self, time_s: float) -> float:
        """Return the travel at a time; exactly the length from the duration on."""
        left_s = self.duration_s - time_s
        if left_s <= 0:
            return self.length_m
        if time_s < self._ramp_s:
            return self._acceleration * time_s * time_s / 2
        if left_s < self._ramp_s:
            return self.length_m - self._acceleration * left_s * left_s / 2
        return self._peak * (time_s - self._ramp_s / 2)


class Motion(Protocol):
    """What the wheels are commanded, tick by tick."""

    @property
    def remaining_s(self) -> float:
        """The time until it is over, as far as is known now; 0 when it is."""
        ...

    @property
    def is_over(self) -> bool:
        """Whether nothing is left to do."""
        ...

    @property
    def noise_share(self) -> float:
        """Which part of a turn in place each metre of the left wheel is; 0 where it is no turn in place."""
        ...

    def step(self) -> tuple[float, float]:
        """Move on by one tick; return what the left and the right wheel are commanded to travel in it, in metres."""
        ...


class Move:
    """One straight drive or turn in place.

    Args:
        left: what the left wheel counts of the profile, under 0 for backwards.
        right: what the right wheel counts of it.
        profile: the travel of each wheel.
        tick_s: length of a physics tick.
    """

    def __init__(self, left: float, right: float, profile: Trapezoid, tick_s: float) -> None:
        self._left, self._right = left, right
        self._profile = profile
        self._tick_s = tick_s
        self._ticks = math.ceil(profile.duration_s / tick_s)
        self._tick = 0
        self._travelled_m = 0.0
        is_turn = left * right < 0 and profile.length_m > 0
        self.noise_share = 1.0 / (left * profile.length_m) if is_turn else 0.0

    @classmethod
    def straight(
        cls,
        make: Make,
        distance_m: float,
        speed_m_s: float,
        tick_s: float,
        calibration: WheelCalibration = NOMINAL,
    ) -> Move:
        """Drive a distance; a negative one is backwards."""
        left, right = calibration.counted(math.copysign(1.0, distance_m), 0.0)
        return cls(left, right, Trapezoid(abs(distance_m), speed_m_s, make.acceleration_m_s2), tick_s)

    @classmethod
    def turn(
        cls,
        make: Make,
        angle_rad: float,
        rate_rad_s: float,
        tick_s: float,
        calibration: WheelCalibration = NOMINAL,
    ) -> Move:
        """Turn in place by an angle; a positive one is to the left."""
        arm_m = make.track_m / 2
        left, right = calibration.counted(0.0, math.copysign(1.0, angle_rad))
        profile = Trapezoid(abs(angle_rad) * arm_m, rate_rad_s * arm_m, make.acceleration_m_s2)
        return cls(left, right, profile, tick_s)

    @property
    def remaining_s(self) -> float:
        """See Motion."""
        return (self._ticks - self._tick) * self._tick_s

    @property
    def done_share(self) -> float:
        """Which part of the way is travelled, 0..1."""
        return self._travelled_m / self._profile.length_m if self._profile.length_m else 1.0

    @property
    def is_over(self) -> bool:
        """See Motion."""
        return self._tick >= self._ticks

    def step(self) -> tuple[float, float]:
        """See Motion."""
        self._tick += 1
        travelled_m = self._profile.travelled_m(self._tick * self._tick_s)
        if self._tick >= self._ticks:
            travelled_m = self._profile.length_m
        step_m, self._travelled_m = travelled_m - self._travelled_m, travelled_m
        return self._left * step_m, self._right * step_m


class Drive:
    """The wheels follow target speeds with the make's acceleration, and rest in the end if the targets are 0.

    Args:
        make: the make.
        speeds_m_s: the wheels' speeds at first, left and right.
        targets_m_s: the speeds to reach.
        hold_s: the targets become 0 after this time; None for never.
        tick_s: length of a physics tick.
    """

    noise_share = 0.0

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
    def remaining_s(self) -> float:
        """See Motion; infinite while nothing ends it."""
        if self._targets_m_s == (0.0, 0.0):
            fastest_m_s = max(abs(self._left_m_s), abs(self._right_m_s))
            return math.ceil(fastest_m_s / (self._acceleration * self._tick_s) - 1e-9) * self._tick_s
        return self._hold_ticks * self._tick_s

    @property
    def is_over(self) -> bool:
        """See Motion."""
        return self._targets_m_s == (0.0, 0.0) and self._left_m_s == self._right_m_s == 0.0

    def step(self) -> tuple[float, float]:
        """See Motion."""
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

    @property
    def speeds_m_s(self) -> tuple[float, float]:
        """The wheels' speeds at this moment."""
        return self._left_m_s, self._right_m_s

    def _follow(self, speed_m_s: float, target_m_s: float) -> tuple[float, float]:
        """Return the travel in a tick, and the speed after it."""
        change = target_m_s - speed_m_s
        ramp_s = abs(change) / self._acceleration
        if ramp_s <= self._tick_s:
            return target_m_s * self._tick_s - change * ramp_s / 2, target_m_s
        gain = math.copysign(self._acceleration * self._tick_s, change)
        return (speed_m_s + gain / 2) * self._tick_s, speed_m_s + gain
