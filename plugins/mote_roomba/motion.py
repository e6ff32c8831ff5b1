"""Motions by the encoders: how fast to go with so much left, and what Drive means a twist."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from eal_actors.plugin import ArgumentError

from .protocol import CLOCKWISE, COUNTER_CLOCKWISE, MAX_RADIUS_MM, MAX_SPEED_MM_S, STRAIGHT, WHEELBASE_M
from .roomba import Reading

ARM_M: Final = WHEELBASE_M / 2
MAX_TURN_RATE_DEG_S: Final = 180.0
_ROUNDING: Final = 1e-9
_BRAKE_M_S2: Final = 0.3
_CREEP_M_S: Final = 0.02
"""The speed at which a motion ends: it comes to rest from there within a millimetre."""


@dataclass(frozen=True, slots=True)
class Motion:
    """One straight drive or turn in place.

    Attributes:
        length_m: what each wheel has to travel, 0 or more.
        speed_m_s: of each wheel at most.
        velocity_sign: of Drive's velocity, 1 or -1.
        radius_mm: of Drive.
        counted_m: what the wheels have travelled its way in all.
    """

    length_m: float
    speed_m_s: float
    velocity_sign: int
    radius_mm: int
    counted_m: Callable[[Reading], float]

    @classmethod
    def straight(cls, distance_m: float, speed_m_s: float) -> Motion:
        """Drive a distance; a negative one is backwards."""
        sign = -1 if distance_m < 0 else 1
        return cls(abs(distance_m), speed_m_s, sign, STRAIGHT, lambda at: sign * (at.left_m + at.right_m) / 2)

    @classmethod
    def turn(cls, angle_rad: float, rate_rad_s: float) -> Motion:
        """Turn in place by an angle; a positive one is to the left."""
        sign, radius_mm = (-1, CLOCKWISE) if angle_rad < 0 else (1, COUNTER_CLOCKWISE)
        length_m = abs(angle_rad) * ARM_M
        return cls(length_m, rate_rad_s * ARM_M, 1, radius_mm, lambda at: sign * (at.right_m - at.left_m) / 2)

    @property
    def goes_forward(self) -> bool:
        """Whether it leads to where the cliff sensors look."""
        return self.radius_mm == STRAIGHT and self.velocity_sign > 0

    def left_m(self, reading: Reading, start_m: float) -> float:
        """Return what was left at a reading of a motion that began with so much counted."""
        return self.length_m - (self.counted_m(reading) - start_m)

    def velocity_mm_s(self, left_m: float) -> int:
        """Return how fast to go with so much of the length left, 1 or more; Drive's sign is not in it."""
        slowing_m_s = math.sqrt(_CREEP_M_S**2 + 2 * _BRAKE_M_S2 * max(left_m, 0.0))
        return max(1, min(MAX_SPEED_MM_S, round(min(self.speed_m_s, slowing_m_s) * 1000)))


class Progress:
    """How far a motion is: by the encoders at each reading, and between readings by the speed that was commanded.

    Attributes:
        velocity_mm_s: the speed that was commanded; whoever commands it sets it.
        stalled_s: how long the encoders have counted nothing though the wheels were driven.
    """

    def __init__(self, motion: Motion, reading: Reading, start_m: float, now_s: float) -> None:
        self.velocity_mm_s = 0
        self.stalled_s = 0.0
        self._motion = motion
        self._start_m = start_m
        self._reading = reading
        self._left_m = motion.left_m(reading, start_m)
        self._at_s = self._moved_s = now_s

    def update(self, reading: Reading, now_s: float) -> float:
        """Return what is left of the length now."""
        if reading is not self._reading:
            self._left_m, self._at_s = self._motion.left_m(reading, self._start_m), reading.stamp_s
            if not reading.stands:
                self._moved_s = now_s
            self._reading = reading
        if not self.velocity_mm_s:
            self._moved_s = now_s
        self.stalled_s = now_s - self._moved_s
        self._left_m -= self.velocity_mm_s / 1000 * (now_s - self._at_s)
        self._at_s = now_s
        return self._left_m


def twist_drive(speed_m_s: float, turn_rate_rad_s: float) -> tuple[int, int]:
    """Return Drive's velocity in mm/s and radius in mm for a twist.

    Where a wheel would have to go faster than it can, the same curve is driven slower. A radius beyond 2 m is taken as
    2 m or as straight, whichever is the nearer curve.

    Args:
        speed_m_s: forward positive.
        turn_rate_rad_s: counter-clockwise positive.

    Raises:
        ArgumentError: the Roomba does not reach the speed or the turn rate, or it is no number.
    """
    _check_reach("speed", speed_m_s, MAX_SPEED_MM_S / 1000, "m/s")
    _check_reach("turn rate", turn_rate_rad_s, math.radians(MAX_TURN_RATE_DEG_S), "rad/s")
    excess = max(1.0, (abs(speed_m_s) + abs(turn_rate_rad_s) * ARM_M) * 1000 / MAX_SPEED_MM_S)
    velocity_mm_s = round(speed_m_s / excess * 1000)
    if abs(turn_rate_rad_s) * 2 * MAX_RADIUS_MM < abs(speed_m_s) * 1000:
        return velocity_mm_s, STRAIGHT
    radius_mm = speed_m_s / turn_rate_rad_s * 1000 if turn_rate_rad_s else 0.0
    if abs(radius_mm) < 1.5:  # 1 and -1 mean in place
        in_place = COUNTER_CLOCKWISE if turn_rate_rad_s > 0 else CLOCKWISE
        return round(abs(turn_rate_rad_s) / excess * ARM_M * 1000), in_place
    return velocity_mm_s, round(max(-MAX_RADIUS_MM, min(MAX_RADIUS_MM, radius_mm)))


def _check_reach(what: str, value: float, most: float, unit: str) -> None:
    if not abs(value) <= most + _ROUNDING:
        raise ArgumentError(
            f"the twist's {what} must be {-most:.4g}..{most:.4g} {unit}, which the roomba reaches, not {value:g}"
        )
