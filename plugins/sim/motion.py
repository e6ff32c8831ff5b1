"""Motions: a trapezoid of speed over a fixed length, cut into physics ticks, and the errors of the wheels.

A motion ends by what the encoders count, and they count what was commanded. So its duration is known beforehand, and
a robot that pushes a wall ends its motion too. Everything here counts in ticks; no clock is read.
"""

from __future__ import annotations

import math

import numpy as np

from .models import Make, WheelErrors

SETTLE_TICKS = 5
"""Ticks with the wheels held still after a motion, in which the body comes to rest."""


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


class Motion:
    """One straight drive or turn in place, tick by tick.

    Args:
        left: the left wheel's direction, 1.0 or -1.0.
        right: the right wheel's direction, 1.0 or -1.0.
        profile: the travel of each wheel.
        tick_s: length of a physics tick.
    """

    def __init__(self, left: float, right: float, profile: Trapezoid, tick_s: float) -> None:
        self._directions = (left, right)
        self._profile = profile
        self._tick_s = tick_s
        self._drive_ticks = math.ceil(profile.duration_s / tick_s)
        self._tick = 0
        self._encoder_m = 0.0

    @classmethod
    def straight(cls, make: Make, distance_m: float, speed_m_s: float, tick_s: float) -> Motion:
        """Drive a distance; a negative one is backwards."""
        direction = math.copysign(1.0, distance_m)
        return cls(direction, direction, Trapezoid(abs(distance_m), speed_m_s, make.acceleration_m_s2), tick_s)

    @classmethod
    def turn(cls, make: Make, angle_rad: float, rate_rad_s: float, tick_s: float) -> Motion:
        """Turn in place by an angle; a positive one is to the left."""
        arm_m = make.track_m / 2
        direction = math.copysign(1.0, angle_rad)
        profile = Trapezoid(abs(angle_rad) * arm_m, rate_rad_s * arm_m, make.acceleration_m_s2)
        return cls(-direction, direction, profile, tick_s)

    @property
    def remaining_s(self) -> float:
        """The time until it is over, settling included; 0 when it is."""
        return (self._drive_ticks + SETTLE_TICKS - self._tick) * self._tick_s

    @property
    def is_over(self) -> bool:
        """True once the body has come to rest."""
        return self._tick >= self._drive_ticks + SETTLE_TICKS

    @property
    def is_settling(self) -> bool:
        """True once all travel is commanded."""
        return self._tick >= self._drive_ticks

    def step(self) -> tuple[float, float]:
        """Move on by one tick; return what the left and the right encoder count in it, in metres."""
        self._tick += 1
        if self._tick >= self._drive_ticks:
            travelled_m = self._profile.length_m
        else:
            travelled_m = self._profile.travelled_m(self._tick * self._tick_s)
        step_m, self._encoder_m = travelled_m - self._encoder_m, travelled_m
        left, right = self._directions
        return left * step_m, right * step_m


class Wheels:
    """Turn what the encoders count into what the wheels travel.

    Args:
        errors: of the make.
        generator: the source of the walk; it is drawn from only in ticks in which the robot is driven.
        tick_s: length of a physics tick.
    """

    def __init__(self, errors: WheelErrors, generator: np.random.Generator, tick_s: float) -> None:
        self._errors = errors
        self._generator = generator
        self._walk_per_tick = errors.walk * math.sqrt(tick_s)
        self._left = self._right = 1.0

    def start(self) -> None:
        """Begin a motion: the walk starts afresh."""
        self._left = self._right = 1.0

    def travel(self, left_m: float, right_m: float) -> tuple[float, float]:
        """Return the wheels' true travel in one tick."""
        if self._walk_per_tick:
            left, right = self._generator.standard_normal(2).tolist()
            self._left += self._walk_per_tick * left
            self._right += self._walk_per_tick * right
        return left_m * self._errors.k_left * self._left, right_m * self._errors.k_right * self._right
