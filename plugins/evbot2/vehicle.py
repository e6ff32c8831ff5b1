"""Vehicle models: the interface of a base's firmware to its wheels, and a vehicle on an endless floor."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, Protocol

from typing_extensions import override

from ..roomba.odometry import DeadReckoning

_BRAKE: Final = 4.0
"""Braking wheels decelerate by this factor faster than driven wheels accelerate."""


class Vehicle(Protocol):
    """Two wheels or tracks with encoders. The simulation's vehicle also has `tick_s`, the length of a physics tick."""

    def drive(self, left_m_s: float, right_m_s: float) -> None:
        """Set the wheels' speeds until the next call; both 0 puts the brakes on."""

    def travel_m(self) -> tuple[float, float]:
        """Return the totals of the left and the right encoder, forward positive."""
        raise NotImplementedError

    def strained(self) -> bool:
        """Return whether something blocks the motors."""
        raise NotImplementedError


class _AcceleratingWheel:
    """A wheel with a limited acceleration."""

    def __init__(self) -> None:
        self.target_m_s = self.speed_m_s = self.travel_m = 0.0

    def turn(self, duration_s: float, acceleration_m_s2: float) -> None:
        lack_m_s = self.target_m_s - self.speed_m_s
        ramp_s = min(duration_s, abs(lack_m_s) / acceleration_m_s2)
        before_m_s = self.speed_m_s
        self.speed_m_s += math.copysign(ramp_s * acceleration_m_s2, lack_m_s)
        if ramp_s < duration_s:
            self.speed_m_s = self.target_m_s
        self.travel_m += (before_m_s + self.speed_m_s) / 2 * ramp_s + self.speed_m_s * (duration_s - ramp_s)


class FreeVehicle(Vehicle):
    """A vehicle on an endless floor, with the kinematics of two tracks.

    Args:
        now_s: returns the time in seconds.
        track_m: nominal distance of the tracks.
        acceleration_m_s2: of each track.
        track_factor: effective over nominal distance: about 1.2 for real tracks, which skid; 1 is ideal.

    Attributes:
        is_stuck: whether its wheels are blocked.
    """

    def __init__(
        self, now_s: Callable[[], float], track_m: float, acceleration_m_s2: float, track_factor: float = 1.0
    ) -> None:
        self._now_s = now_s
        self._acceleration_m_s2 = acceleration_m_s2
        self._at_s = now_s()
        self._left, self._right = _AcceleratingWheel(), _AcceleratingWheel()
        self._odometer = DeadReckoning(track_m * track_factor)
        self.is_stuck = False

    @property
    def pose(self) -> tuple[float, float, float]:
        """Its true pose: x in m, y in m, yaw in rad, in (-pi, pi]."""
        self._catch_up()
        return self._odometer.pose

    @override
    def drive(self, left_m_s: float, right_m_s: float) -> None:
        self._catch_up()
        self._left.target_m_s, self._right.target_m_s = left_m_s, right_m_s

    @override
    def travel_m(self) -> tuple[float, float]:
        self._catch_up()
        return self._left.travel_m, self._right.travel_m

    @override
    def strained(self) -> bool:
        return self.is_stuck and self._is_driven

    @property
    def _is_driven(self) -> bool:
        return bool(self._left.target_m_s or self._right.target_m_s)

    def _catch_up(self) -> None:
        now_s = self._now_s()
        duration_s, self._at_s = now_s - self._at_s, now_s
        if self.is_stuck or duration_s <= 0:
            return
        before_m = self._left.travel_m, self._right.travel_m
        acceleration_m_s2 = self._acceleration_m_s2 * (1.0 if self._is_driven else _BRAKE)
        for wheel in (self._left, self._right):
            wheel.turn(duration_s, acceleration_m_s2)
        self._odometer.add(self._left.travel_m - before_m[0], self._right.travel_m - before_m[1])
