"""A turret: it turns by itself, on top of what its robot does."""

from __future__ import annotations

import math
from collections.abc import Callable

from .models import TurretModel
from .motion import Trapezoid


class Turret:
    """A joint without mass that turns with limited rate and acceleration, worked out only when somebody asks.

    Args:
        model: of the make.
        now_s: tells the world's time, in seconds.

    Thread: every member is for the holder of the world's lock.
    """

    def __init__(self, model: TurretModel, now_s: Callable[[], float]) -> None:
        self.model = model
        self._now_s = now_s
        self._from_rad = 0.0
        self._sense = 1.0
        self._profile = Trapezoid(0.0, 1.0, 1.0)
        self._since_s = 0.0

    @property
    def yaw_rad(self) -> float:
        """Its angle, counter-clockwise from straight ahead, unwrapped."""
        return self._from_rad + self._sense * self._profile.travelled_m(self._now_s() - self._since_s)

    @property
    def remaining_s(self) -> float:
        """The time until it rests; 0 when it does."""
        return max(0.0, self._since_s + self._profile.duration_s - self._now_s())

    def turn(self, angle_rad: float, rate_rad_s: float) -> None:
        """Begin to turn by an angle, to the left where it is positive, in place of what it did."""
        self._from_rad, self._since_s = self.yaw_rad, self._now_s()
        self._sense = math.copysign(1.0, angle_rad)
        self._profile = Trapezoid(abs(angle_rad), rate_rad_s, math.radians(self.model.acceleration_deg_s2))

    def stop(self) -> None:
        """Stop at once."""
        self.turn(0.0, 1.0)
