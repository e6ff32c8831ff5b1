"""The bumpers and the battery of an EvBot III, from the latest status; and its base, which the bumpers stop."""

from __future__ import annotations

import math

from typing_extensions import override

from eal_actors.plugin import Resource

from ..evbot2.base import Base
from ..evbot2.session import BaseSession
from ..roomba.senses import BatteryReading, BumpSensor, PowerSensor
from .status import SenseStatus, senses_of

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

    def __init__(self, session: BaseSession) -> None:
        self._session = session

    def not_ready(self) -> str | None:
        """Return why the base cannot be read now."""
        return self._session.why_not_ready()

    def _status(self) -> tuple[SenseStatus, float]:
        """Return the latest status and its time."""
        reading = self._session.latest()
        return senses_of(reading), reading.stamp_s


class Bump(_StatusSensor, BumpSensor):
    """Whether something touches the front half of the robot."""

    @override
    def read_flags(self) -> tuple[tuple[bool, ...], float]:
        senses, stamp_s = self._status()
        return (bool(senses.bumpers & _LEFT), bool(senses.bumpers & _RIGHT)), stamp_s


class Battery(_StatusSensor, PowerSensor):
    """The battery's charge, 0 to 1."""

    @override
    def read_battery(self) -> tuple[BatteryReading, float]:
        senses, stamp_s = self._status()
        fraction = senses.charge_mah / senses.capacity_mah if senses.capacity_mah > 0 else 0.0
        electric = senses.voltage_mv, senses.current_ma, senses.charge_mah, senses.capacity_mah
        milli = *electric, senses.temperature_mc
        return BatteryReading(min(max(fraction, 0.0), 1.0), *(number / 1000 for number in milli)), stamp_s
