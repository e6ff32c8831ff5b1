"""The wheels of a robot: what their encoders count, and what they truly travel."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from eal_actors.plugin import WheelCalibration

from .models import Make
from .motion import NOMINAL, Motion

_BLOCK: Final = 128
"""Normal numbers are drawn in blocks: one by one they cost more than the rest of a tick."""

_ROUNDING: Final = 1e-6
"""Of an encoder step: a sum that falls short of a step by less has reached it."""


class Wheels:
    """Count what is commanded, and turn it into what the wheels travel.

    Args:
        make: whose errors they have.
        generator: the source of the errors' noise; it is drawn from only for ticks in which the robot is driven.
        tick_s: length of a physics tick.

    Attributes:
        turned_m: what both wheels were commanded to turn in all, either way, on the average.
        shares: of what they are commanded, the left and the right wheel turn so much: under 1 for weak motors.
    """

    def __init__(self, make: Make, generator: np.random.Generator, tick_s: float) -> None:
        self._errors = make.errors
        self._turn_noise_rad = make.turn_noise_rad
        self._step_m = make.encoder_step_m
        self._track_m = make.track_m * make.errors.track_factor
        self._walk_per_tick = make.errors.walk * math.sqrt(tick_s)
        self._normals = _normals(generator)
        self._left_factor = self._right_factor = 1.0
        self._noise_rad_m = 0.0
        self._left_m = self._right_m = 0.0
        self.turned_m = 0.0
        self.shares = (1.0, 1.0)

    def start(self, motion: Motion) -> None:
        """Begin a motion: the walk starts afresh, and a turn in place gets its noise."""
        self._left_factor, self._right_factor = self._errors.k_left, self._errors.k_right
        self._noise_rad_m = 0.0
        if self._turn_noise_rad and motion.noise_share:
            self._noise_rad_m = next(self._normals) * self._turn_noise_rad * motion.noise_share

    def travel(self, left_m: float, right_m: float) -> tuple[float, float]:
        """Count one tick's command, and return how far the robot goes ahead, in metres, and turns, in radians."""
        self.turned_m += (abs(left_m) + abs(right_m)) / 2
        left_m, right_m = left_m * self.shares[0], right_m * self.shares[1]
        self._left_m += left_m
        self._right_m += right_m
        if self._walk_per_tick:
            self._left_factor += self._walk_per_tick * next(self._normals)
            self._right_factor += self._walk_per_tick * next(self._normals)
        left, right = left_m * self._left_factor, right_m * self._right_factor
        return (left + right) / 2, (right - left) / self._track_m + left_m * self._noise_rad_m

    @property
    def counted_m(self) -> tuple[float, float]:
        """What the encoders have counted in all, left and right, in whole steps."""
        step_m = self._step_m
        return (
            math.floor(self._left_m / step_m + _ROUNDING) * step_m,
            math.floor(self._right_m / step_m + _ROUNDING) * step_m,
        )


class DeadReckoning:
    """Where a robot believes it is, from its encoders, its nominal track and what it knows of its wheels.

    Args:
        track_m: the nominal distance of the wheels.
        counted_m: what the encoders have counted so far.

    Attributes:
        pose: x_m, y_m, yaw_rad, from (0, 0, 0) at first; yaw unwrapped.
    """

    def __init__(self, track_m: float, counted_m: tuple[float, float]) -> None:
        self.pose = (0.0, 0.0, 0.0)
        self._track_m = track_m
        self._counted_m = counted_m

    def follow(self, counted_m: tuple[float, float], calibration: WheelCalibration = NOMINAL) -> None:
        """Take in what the encoders have counted by now, with wheels that are believed to be so."""
        before_m = self._counted_m
        self._counted_m = counted_m
        ahead_m, arc_m = calibration.travelled(counted_m[0] - before_m[0], counted_m[1] - before_m[1])
        self.pose = moved(self.pose, ahead_m, arc_m / (self._track_m / 2))


def moved(pose: tuple[float, float, float], ahead_m: float, turn_rad: float) -> tuple[float, float, float]:
    """Return a pose after an arc: so far ahead along it, while turning evenly by an angle."""
    x_m, y_m, yaw_rad = pose
    half_rad = turn_rad / 2
    chord_m = ahead_m * math.sin(half_rad) / half_rad if abs(half_rad) > 1e-9 else ahead_m
    heading_rad = yaw_rad + half_rad
    return x_m + chord_m * math.cos(heading_rad), y_m + chord_m * math.sin(heading_rad), yaw_rad + turn_rad


def _normals(generator: np.random.Generator) -> Iterator[float]:
    while True:
        yield from generator.standard_normal(_BLOCK).tolist()
