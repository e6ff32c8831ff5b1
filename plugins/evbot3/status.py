"""The numbers of an EvBot III's status after those of the wheels: turret, bumpers and battery."""

from __future__ import annotations

from typing import Final, NamedTuple

from eal_actors.plugin import UnavailableError

from ..evbot2.session_state import StatusReading


class TurretStatus(NamedTuple):
    """The turret."""

    order: int
    """Tag of the last motion order that was accepted."""
    state: int
    """Its State."""
    yaw_urad: int
    """Its angle to the left of straight ahead, in (-pi, pi]."""


class SenseStatus(NamedTuple):
    """Bumpers and battery."""

    bumpers: int
    """Bit 0 left, bit 1 right: pressed."""
    voltage_mv: int
    current_ma: int
    """Below 0 while the battery is drained."""
    charge_mah: int
    capacity_mah: int
    temperature_mc: int
    """In thousandths of a degree Celsius."""


_TURRET_NUMBERS: Final = len(TurretStatus._fields)
_NUMBERS: Final = _TURRET_NUMBERS + len(SenseStatus._fields)


def turret_of(reading: StatusReading) -> TurretStatus:
    """Return a reading's turret; raises UnavailableError if it has none."""
    return TurretStatus(*_extra_numbers(reading)[:_TURRET_NUMBERS])


def senses_of(reading: StatusReading) -> SenseStatus:
    """Return a reading's bumpers and battery; raises UnavailableError if it has none."""
    return SenseStatus(*_extra_numbers(reading)[_TURRET_NUMBERS:])


def _extra_numbers(reading: StatusReading) -> tuple[int, ...]:
    if len(reading.rest) != _NUMBERS:
        raise UnavailableError(f"the base's status has {len(reading.rest)} numbers after the wheels', not {_NUMBERS}")
    return reading.rest
