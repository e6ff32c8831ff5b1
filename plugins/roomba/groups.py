"""The sensor groups of the Serial Command Interface: the replies to Sensors.

Source: iRobot Roomba Serial Command Interface (SCI) specification.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Final

from eal_actors.plugin import DataError


def bits(*flags: bool) -> int:
    """Return a byte with a bit for each flag, the lowest first."""
    return sum(1 << place for place, flag in enumerate(flags) if flag)


@dataclass(frozen=True, slots=True)
class Contacts:
    """Sensor group 1: bumpers, cliffs, drops and walls."""

    bump_right: bool = False
    bump_left: bool = False
    drop_right: bool = False
    drop_left: bool = False
    drop_caster: bool = False
    wall: bool = False
    cliff_left: bool = False
    cliff_front_left: bool = False
    cliff_front_right: bool = False
    cliff_right: bool = False
    virtual_wall: bool = False
    overcurrent_side_brush: bool = False
    overcurrent_vacuum: bool = False
    overcurrent_main_brush: bool = False
    overcurrent_drive_right: bool = False
    overcurrent_drive_left: bool = False
    dirt_left: int = 0
    dirt_right: int = 0

    @property
    def drops(self) -> tuple[bool, bool, bool]:
        """Whether the left wheel, the right wheel and the caster have dropped."""
        return self.drop_left, self.drop_right, self.drop_caster

    @property
    def any_drop(self) -> bool:
        """Whether any wheel has dropped."""
        return any(self.drops)

    @property
    def cliffs(self) -> tuple[bool, bool, bool, bool]:
        """Whether each cliff sensor misses the floor, from the left to the right."""
        return self.cliff_left, self.cliff_front_left, self.cliff_front_right, self.cliff_right

    @property
    def any_cliff(self) -> bool:
        """Whether any cliff sensor misses the floor."""
        return any(self.cliffs)

    def encode(self) -> bytes:
        """Return the group's 10 bytes."""
        flags = _flags_of(self)
        return bytes([bits(*flags[:5]), *flags[5:11], bits(*flags[11:16]), self.dirt_left, self.dirt_right])

    @classmethod
    def decode(cls, data: bytes) -> Contacts:
        """Read the group's 10 bytes.

        Raises:
            DataError: they are not a valid group.
        """
        _check(data, 1)
        bumps = _flags(data, 0, 5)
        singles = [_flags(data, place, 1)[0] for place in range(1, 7)]
        flags = (*bumps, *singles, *_flags(data, 7, 5))
        named = dict(zip(CONTACT_FLAGS, flags, strict=True))
        return cls(**named, dirt_left=data[8], dirt_right=data[9])


CONTACT_FLAGS: Final = tuple(field.name for field in fields(Contacts))[:16]
"""The names of the flags among the contacts, in the order of the wire."""
_flags_of: Final = attrgetter(*CONTACT_FLAGS)

NO_REMOTE: Final = 255
"""The remote control's byte while none of its buttons is pressed."""


@dataclass(frozen=True, slots=True)
class Controls:
    """Sensor group 2: buttons, and the travel of the wheels since the last reading of this group.

    Attributes:
        remote: code of the remote control's button, NO_REMOTE for none.
        button_max: whether it is pressed; likewise the others.
        distance_mm: mean of both wheels' travel, forward positive.
        angle_mm: half the difference of their travels, right minus left: counter-clockwise positive.
    """

    remote: int = NO_REMOTE
    button_max: bool = False
    button_clean: bool = False
    button_spot: bool = False
    button_power: bool = False
    distance_mm: int = 0
    angle_mm: int = 0

    @property
    def pressed(self) -> frozenset[str]:
        """The buttons on the Roomba that are pressed."""
        pressed = {"max": self.button_max, "clean": self.button_clean, "spot": self.button_spot}
        return frozenset(name for name, is_so in {**pressed, "power": self.button_power}.items() if is_so)

    def encode(self) -> bytes:
        """Return the group's 6 bytes."""
        buttons = bits(self.button_max, self.button_clean, self.button_spot, self.button_power)
        return struct.pack(">2B2h", self.remote, buttons, self.distance_mm, self.angle_mm)

    @classmethod
    def decode(cls, data: bytes) -> Controls:
        """Read the group's 6 bytes.

        Raises:
            DataError: they are not a valid group.
        """
        _check(data, 2)
        button_max, button_clean, button_spot, button_power = _flags(data, 1, 4)
        distance_mm, angle_mm = struct.unpack(">2h", data[2:])
        return cls(data[0], button_max, button_clean, button_spot, button_power, distance_mm, angle_mm)


CHARGING_STATES: Final = (
    "not charging",
    "charging recovery",
    "charging",
    "trickle charging",
    "waiting",
    "charge error",
)


_POWER_RANGES: Final = {
    "voltage_mv": (0, 30_000),
    "current_ma": (-20_000, 20_000),
    "temperature_c": (-40, 100),
    "charge_mah": (0, 10_000),
    "capacity_mah": (0, 10_000),
}
_POWER_STEPS: Final = {"voltage_mv": 3_000, "temperature_c": 10, "charge_mah": 300, "capacity_mah": 300}


@dataclass(frozen=True, slots=True)
class PowerGroup:
    """Sensor group 3: the battery.

    Attributes:
        charging_state: place in CHARGING_STATES.
        voltage_mv: of the battery, 0..65535.
        current_ma: negative while it is discharged.
        charge_mah: the remaining charge.
        capacity_mah: the charge when full.
    """

    charging_state: int = 0
    voltage_mv: int = 0
    current_ma: int = 0
    temperature_c: int = 0
    charge_mah: int = 0
    capacity_mah: int = 0

    @property
    def is_charging(self) -> bool:
        """Whether it is charged, which ends safe mode."""
        return CHARGING_STATES[self.charging_state] in ("charging recovery", "charging", "trickle charging")

    @property
    def fraction(self) -> float:
        """The charge of the battery, 0..1."""
        return min(1.0, self.charge_mah / self.capacity_mah) if self.capacity_mah else 0.0

    def check(self) -> None:
        """Check the ranges.

        Raises:
            DataError: no battery of a Roomba is so.
        """
        for name, (least, most) in _POWER_RANGES.items():
            if not least <= getattr(self, name) <= most:
                raise DataError(f"SCI: {name} of a Roomba is {least}..{most}, not {getattr(self, name)}")

    def follows(self, before: PowerGroup) -> bool:
        """Return whether the battery can have changed so from one reading to the next."""
        return all(abs(getattr(self, name) - getattr(before, name)) <= most for name, most in _POWER_STEPS.items())

    def encode(self) -> bytes:
        """Return the group's 10 bytes."""
        return struct.pack(">BHhb2H", *_power_of(self))

    @classmethod
    def decode(cls, data: bytes) -> PowerGroup:
        """Read the group's 10 bytes.

        Raises:
            DataError: they are not a valid group.
        """
        _check(data, 3)
        if data[0] >= len(CHARGING_STATES):
            raise DataError(f"SCI: byte 0 of sensor group 3 is a charging state, 0..5, not {data[0]}")
        return cls(*struct.unpack(">BHhb2H", data))


_power_of: Final = attrgetter(*(field.name for field in fields(PowerGroup)))


@dataclass(frozen=True, slots=True)
class Sensors:
    """Sensor group 0: all sensors."""

    contacts: Contacts
    controls: Controls
    power: PowerGroup

    def encode(self) -> bytes:
        """Return the group's 26 bytes."""
        return self.contacts.encode() + self.controls.encode() + self.power.encode()

    @classmethod
    def decode(cls, data: bytes) -> Sensors:
        """Read the group's 26 bytes.

        Raises:
            DataError: they are not a valid group.
        """
        _check(data, 0)
        return cls(Contacts.decode(data[:10]), Controls.decode(data[10:16]), PowerGroup.decode(data[16:]))


GROUP_BYTES: Final = (26, 10, 6, 10)
"""The size of each sensor group."""


def is_group(group: int, data: bytes) -> bool:
    """Return whether bytes can be a sensor group."""
    try:
        (Sensors, Contacts, Controls, PowerGroup)[group].decode(data)
    except DataError:
        return False
    return True


def _check(data: bytes, group: int) -> None:
    if len(data) != GROUP_BYTES[group]:
        raise DataError(f"SCI: sensor group {group} has {GROUP_BYTES[group]} bytes, not {len(data)}")


def _flags(data: bytes, place: int, count: int) -> list[bool]:
    """Return the lowest bits of a byte; raise DataError if others are set, because the group is misaligned."""
    if data[place] >> count:
        raise DataError(f"SCI: byte {place} of a sensor group holds {count} flags, but is {data[place]}")
    return [bool(data[place] >> bit & 1) for bit in range(count)]
