"""What an EvBot III's status has behind that of the wheels: turret, bumpers and battery, as numbers and as values."""

from __future__ import annotations

from typing import Final, NamedTuple

from eal_actors.plugin import UnavailableError

from ..evbot2.session import Reading


class TurretStatus(NamedTuple):
    """The turret."""

    order: int
    """Tag of the last motion order that was accepted."""
    state: int
    """A State: what became of it."""
    yaw_urad: int
    """Its angle to the left of straight ahead, in (-pi, pi]."""


class SenseStatus(NamedTuple):
    """Bumpers and battery."""

    bumpers: int
    """Bit 0 left, bit 1 right: pressed."""
    voltage_mv: int
    current_ma: int
    """Under 0 while the battery is drained."""
    charge_mah: int
    capacity_mah: int
    temperature_mc: int
    """In thousandths of a degree Celsius."""


_TURRET_NUMBERS: Final = len(TurretStatus._fields)
_NUMBERS: Final = _TURRET_NUMBERS + len(SenseStatus._fields)


def turret_of(reading: Reading) -> TurretStatus:
    """Return a reading's turret; raises UnavailableError if it has none."""
    return TurretStatus(*_checked(reading)[:_TURRET_NUMBERS])


def senses_of(reading: Reading) -> SenseStatus:
    """Return a reading's bumpers and battery; raises UnavailableError if it has none."""
    return SenseStatus(*_checked(reading)[_TURRET_NUMBERS:])


def _checked(reading: Reading) -> tuple[int, ...]:
    if len(reading.rest) != _NUMBERS:
        raise UnavailableError(f"the base's status has {len(reading.rest)} numbers behind the wheels', not {_NUMBERS}")
    return reading.rest
