"""The turret of a simulated robot."""

from __future__ import annotations

import math
from collections.abc import Callable

from .models import TurretModel
from .motion import Trapezoid


class SimTurret:
    """A massless joint with limited rate and acceleration, independent of the robot's motion. Computed on access.

    Args:
        model: the turret model of the make.
        now_s: returns the world's time, in seconds.

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
        """The time until it rests; 0 at rest."""
        return max(0.0, self._since_s + self._profile.duration_s - self._now_s())

    def turn(self, angle_rad: float, rate_rad_s: float) -> None:
        """Begin to turn by an angle, positive to the left, in place of the running turn."""
        self._from_rad, self._since_s = self.yaw_rad, self._now_s()
        self._sense = math.copysign(1.0, angle_rad)
        self._profile = Trapezoid(abs(angle_rad), rate_rad_s, math.radians(self.model.acceleration_deg_s2))

    def stop(self) -> None:
        """Stop at once."""
        self.turn(0.0, 1.0)
