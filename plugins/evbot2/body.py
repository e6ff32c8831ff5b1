"""The mechanics under a base: what its firmware drives and feels, and a body of its own for free space."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, Protocol

from ..roomba.odometry import DeadReckoning

_BRAKE: Final = 4.0
"""Wheels that are braked slow down so many times as fast as wheels that are driven."""


class Body(Protocol):
    """Two wheels or tracks with encoders, simulated or made up."""

    def drive(self, left_m_s: float, right_m_s: float) -> None:
        """Set the wheels' speeds until the next call; both 0 puts the brakes on."""
        ...

    def travel_m(self) -> tuple[float, float]:
        """Return what the left and the right wheel's encoder have counted in all, forward positive."""
        ...

    def strained(self) -> bool:
        """Return whether the motors strain against something that holds the robot up."""
        ...


class SimulatedBody(Body, Protocol):
    """A body that somebody simulates in steps, and whose firmware is called once a step while it is busy."""

    @property
    def tick_s(self) -> float:
        """Length of a step."""
        ...


class _Wheel:
    """A wheel that takes time to reach its speed."""

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


class FreeBody:
    """A body on an endless floor, with a pose by the model of two tracks.

    Args:
        now_s: tells the time in seconds.
        track_m: nominal distance of the tracks.
        acceleration_m_s2: of each track.
        track_factor: effective over nominal distance: tracks skid, so that about 1.2 is true, and 1 is ideal.

    Attributes:
        is_stuck: whether its motors turn nothing.
    """

    def __init__(
        self, now_s: Callable[[], float], track_m: float, acceleration_m_s2: float, track_factor: float = 1.0
    ) -> None:
        self._now_s = now_s
        self._acceleration_m_s2 = acceleration_m_s2
        self._at_s = now_s()
        self._left, self._right = _Wheel(), _Wheel()
        self._place = DeadReckoning(track_m * track_factor)
        self.is_stuck = False

    @property
    def pose(self) -> tuple[float, float, float]:
        """Where it truly is: x in m, y in m, yaw in rad, in (-pi, pi]."""
        self._catch_up()
        return self._place.pose

    def drive(self, left_m_s: float, right_m_s: float) -> None:
        """See Body."""
        self._catch_up()
        self._left.target_m_s, self._right.target_m_s = left_m_s, right_m_s

    def travel_m(self) -> tuple[float, float]:
        """See Body."""
        self._catch_up()
        return self._left.travel_m, self._right.travel_m

    def strained(self) -> bool:
        """See Body."""
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
        self._place.add(self._left.travel_m - before_m[0], self._right.travel_m - before_m[1])
