"""The battery of a robot: drained by time and by driving, worked out only when somebody asks."""

from __future__ import annotations

from typing import Final

from .models import BatteryModel

ROOM_C: Final = 22.0
_WARMING_C_A2: Final = 0.8
_SECONDS_PER_HOUR: Final = 3600.0


class Battery:
    """A battery at a moment.

    Args:
        model: of the make.
        fraction: how full it is at first, 0..1.

    Attributes:
        has_failed: whether it gives nothing, however full it was.

    Thread: every member is for the holder of the world's lock.
    """

    def __init__(self, model: BatteryModel, fraction: float = 1.0) -> None:
        self._model = model
        self._before_as = (1.0 - fraction) * model.capacity_ah * _SECONDS_PER_HOUR
        self._drawn_as = self._speed_m_s = 0.0
        self.has_failed = False

    def follow(self, now_s: float, turned_m: float, speed_m_s: float) -> None:
        """Take in the time, what the wheels have turned in all, and how fast they turn, on the average of both.

        What was drawn follows from the totals, so that it does not matter how often somebody asks.
        """
        self._drawn_as = self._model.idle_a * now_s + self._model.drive_as_m * turned_m
        self._speed_m_s = speed_m_s

    def is_empty_after(self, now_s: float, turned_m: float) -> bool:
        """Whether it holds nothing more at a time, when the wheels have turned so far: the short way, for each tick."""
        drawn_as = self._before_as + self._model.idle_a * now_s + self._model.drive_as_m * turned_m
        return self.has_failed or drawn_as >= self._model.capacity_ah * _SECONDS_PER_HOUR

    def set_fraction(self, fraction: float) -> None:
        """Fill it or drain it to a fraction of its capacity, 0..1."""
        self._before_as = (1.0 - fraction) * self._model.capacity_ah * _SECONDS_PER_HOUR - self._drawn_as

    @property
    def capacity_ah(self) -> float:
        """What it holds when full."""
        return self._model.capacity_ah

    @property
    def charge_ah(self) -> float:
        """What it holds."""
        if self.has_failed:
            return 0.0
        return max(0.0, self._model.capacity_ah - (self._before_as + self._drawn_as) / _SECONDS_PER_HOUR)

    @property
    def fraction(self) -> float:
        """How full it is, 0..1."""
        return self.charge_ah / self._model.capacity_ah

    @property
    def is_empty(self) -> bool:
        """Whether it holds nothing more."""
        return self.charge_ah <= 0.0

    @property
    def current_a(self) -> float:
        """The current into it: negative, for it is drained; 0 when it is empty."""
        if self.is_empty:
            return 0.0
        return -(self._model.idle_a + self._model.drive_as_m * self._speed_m_s)

    @property
    def voltage_v(self) -> float:
        """The voltage between its poles under the present current."""
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
        """Its temperature: that of the room, and warmer the more it gives."""
        return ROOM_C + _WARMING_C_A2 * self.current_a**2
