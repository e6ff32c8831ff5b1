"""The bumpers and the battery of an EvBot III, from the latest status; and its base, which the bumpers stop."""

from __future__ import annotations

import math
from typing import Final

from typing_extensions import override

from eal_actors.plugin import DataType, EALData, Resource, ResourceType, ValueInfo, request

from ..evbot2.base import Base
from ..evbot2.session import BaseSession
from .status import SenseStatus, senses_of

_FLAG: Final = ValueInfo(DataType.BOOL)
_LEFT, _RIGHT = 1, 2


class BumperBase(Base):
    """Drives the robot; get_status: 0 stands, 1 moves, 2 is driven but blocked.

    A pressed bumper stops motions to a place.
    """

    @override
    def clearance_m(self, *, forward: bool) -> float:
        return 0.0 if forward and senses_of(self._session.latest()).bumpers else math.inf


class _StatusSensor(Resource):
    """A sensor of the base.

    Args:
        session: the session with the base, which Base polls.
    """

    types = ResourceType.SENSOR

    def __init__(self, session: BaseSession) -> None:
        self._session = session

    def not_ready(self) -> str | None:
        """Return why the base cannot be read now."""
        return self._session.why_not_ready()

    def _status(self) -> tuple[SenseStatus, float]:
        """Return the latest status and its time."""
        reading = self._session.latest()
        return senses_of(reading), reading.stamp_s


class Bump(_StatusSensor):
    """Whether something touches the front half of the robot."""

    value = _FLAG

    def get_value(self) -> EALData:
        """Return whether any bumper is pressed now."""
        return self._pressed(_LEFT | _RIGHT)

    @request("left", _FLAG)
    def left(self) -> EALData:
        """Return whether the left bumper is pressed; an obstacle straight ahead presses both."""
        return self._pressed(_LEFT)

    @request("right", _FLAG)
    def right(self) -> EALData:
        """Return whether the right bumper is pressed; an obstacle straight ahead presses both."""
        return self._pressed(_RIGHT)

    def _pressed(self, bits: int) -> EALData:
        senses, stamp_s = self._status()
        return EALData.of(bool(senses.bumpers & bits), stamp_s=stamp_s)


class Battery(_StatusSensor):
    """The battery's charge, 0 to 1."""

    value = ValueInfo(DataType.DOUBLE, None, 0, 1, description="fraction of the capacity that is left")

    def get_value(self) -> EALData:
        """Return the charge as a share of the capacity."""
        senses, stamp_s = self._status()
        fraction = senses.charge_mah / senses.capacity_mah if senses.capacity_mah > 0 else 0.0
        return EALData.of(min(max(fraction, 0.0), 1.0), stamp_s=stamp_s)

    @request("voltage", ValueInfo(DataType.DOUBLE, "V"))
    def voltage(self) -> EALData:
        """Return the terminal voltage."""
        return self._milli("voltage_mv", "V")

    @request("current", ValueInfo(DataType.DOUBLE, "A"))
    def current(self) -> EALData:
        """Return the charging current, negative while the battery is drained."""
        return self._milli("current_ma", "A")

    @request("charge", ValueInfo(DataType.DOUBLE, "A h"))
    def charge(self) -> EALData:
        """Return the remaining charge."""
        return self._milli("charge_mah", "A h")

    @request("capacity", ValueInfo(DataType.DOUBLE, "A h"))
    def capacity(self) -> EALData:
        """Return the full charge."""
        return self._milli("capacity_mah", "A h")

    @request("temperature", ValueInfo(DataType.DOUBLE, "degC"))
    def temperature(self) -> EALData:
        """Return its temperature."""
        return self._milli("temperature_mc", "degC")

    def _milli(self, name: str, unit: str) -> EALData:
        senses, stamp_s = self._status()
        return EALData.of(float(getattr(senses, name)) / 1000, unit=unit, stamp_s=stamp_s)
