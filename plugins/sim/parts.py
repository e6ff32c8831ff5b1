"""The parts of a simulated robot beside its drive: the battery and the turret. Both are computed on access."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from .models import BatteryModel, TurretModel
from .motion import Trapezoid

ROOM_C: Final = 22.0
_WARMING_C_A2: Final = 0.8
_SECONDS_PER_HOUR: Final = 3600.0


class SimBattery:
    """A battery, drained by time and by driving. It is computed on access.

    Args:
        fraction: initial charge, 0..1.
        since_s: the world's time at which it had that charge.

    Attributes:
        has_failed: whether it is treated as empty, whatever its charge.

    Thread: every member is for the holder of the world's lock.
    """

    def __init__(self, model: BatteryModel, fraction: float = 1.0, since_s: float = 0.0) -> None:
        self._model = model
        self._capacity_as = model.capacity_ah * _SECONDS_PER_HOUR
        self._before_as = (1.0 - fraction) * self._capacity_as - model.idle_a * since_s
        self._drawn_as = self._speed_m_s = 0.0
        self.has_failed = False

    def follow(self, now_s: float, turned_m: float, speed_m_s: float) -> None:
        """Update from the time, the total travel and the speed of the wheels, each the mean of both wheels.

        The drawn charge follows from the totals, so it does not depend on how often this is called.
        """
        self._drawn_as = self._model.idle_a * now_s + self._model.drive_as_m * turned_m
        self._speed_m_s = speed_m_s

    @property
    def limits(self) -> tuple[float, float, float, float]:
        """The charge drawn at the world's time 0 and no travel, the currents of `BatteryModel`, and the capacity."""
        return self._before_as, self._model.idle_a, self._model.drive_as_m, self._capacity_as

    def is_empty_after(self, now_s: float, turned_m: float) -> bool:
        """Return whether it is empty at a time and a total travel: a shortcut for each tick."""
        drawn_as = self._before_as + self._model.idle_a * now_s + self._model.drive_as_m * turned_m
        return self.has_failed or drawn_as >= self._capacity_as

    @property
    def capacity_ah(self) -> float:
        """The full charge."""
        return self._model.capacity_ah

    @property
    def charge_ah(self) -> float:
        """The remaining charge."""
        if self.has_failed:
            return 0.0
        return max(0.0, self._model.capacity_ah - (self._before_as + self._drawn_as) / _SECONDS_PER_HOUR)

    @property
    def fraction(self) -> float:
        """The remaining charge as a share of the capacity, 0..1."""
        return self.charge_ah / self._model.capacity_ah

    @property
    def is_empty(self) -> bool:
        """Whether no charge remains."""
        return self.charge_ah <= 0.0

    @property
    def current_a(self) -> float:
        """The charging current: negative while drained, 0 when empty."""
        if self.is_empty:
            return 0.0
        return -(self._model.idle_a + self._model.drive_as_m * self._speed_m_s)

    @property
    def voltage_v(self) -> float:
        """The terminal voltage under the present current."""
        model, fraction = self._model, self.fraction
        low_v, high_v = model.flat_v
        if fraction < 0.1:
            open_v = model.empty_v + (low_v - model.empty_v) * fraction / 0.1
        elif fraction > 0.9:
            open_v = high_v + (model.full_v - high_v) * (fraction - 0.9) / 0.1
        else:
            open_v = low_v + (high_v - low_v) * (fraction - 0.1) / 0.8
        return open_v + self.current_a * model.resistance_ohm

    @property
    def temperature_c(self) -> float:
        """Its temperature: room temperature, plus warming by the current."""
        return ROOM_C + _WARMING_C_A2 * self.current_a**2


class SimTurret:
    """A massless joint with limited rate and acceleration, independent of the robot's motion. Computed on access.

    Args:
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
