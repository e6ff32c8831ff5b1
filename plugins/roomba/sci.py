"""The iRobot Serial Command Interface of the Roomba 4xx: encoding and decoding of bytes.

Numbers here are the wire's: millimetres, millimetres per second, millivolts, big-endian and in two's complement.

Source: iRobot Roomba Serial Command Interface (SCI) specification; thesis §6.1.3.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from eal_actors.plugin import ArgumentError

from .groups import GROUP_BYTES, bits

MODE_PAUSE_S: Final = 0.02
"""Pause after a command that changes the mode."""
BAUD_PAUSE_S: Final = 0.1
"""Pause after a change of the baud rate."""
BAUD_RATE: Final = 57600
WHEELBASE_M: Final = 0.258
MAX_SPEED_MM_S: Final = 500
MAX_RADIUS_MM: Final = 2000
STRAIGHT: Final = -0x8000
"""The radius that means straight ahead."""
CLOCKWISE: Final = -1
"""The radius that means turning in place to the right."""
COUNTER_CLOCKWISE: Final = 1
"""The radius that means turning in place to the left."""
NO_OP_CODE: Final = 0
"""A Roomba ignores it between commands; after a command that has lost a byte it completes that one."""
SONGS: Final = 16
MAX_NOTES: Final = 16
BAUD_RATES: Final = (300, 600, 1200, 2400, 4800, 9600, 14400, 19200, 28800, 38400, 57600, 115200)
"""The baud rates, each at the place of its code."""


class Op(enum.IntEnum):
    """The op codes."""

    START = 128
    BAUD = 129
    CONTROL = 130
    SAFE = 131
    FULL = 132
    POWER = 133
    SPOT = 134
    CLEAN = 135
    MAX = 136
    DRIVE = 137
    MOTORS = 138
    LEDS = 139
    SONG = 140
    PLAY = 141
    SENSORS = 142
    SEEK_DOCK = 143


class Mode(enum.Enum):
    """The modes of the interface."""

    OFF = "off"
    PASSIVE = "passive"
    SAFE = "safe"
    FULL = "full"


class StatusLed(enum.IntEnum):
    """The colours of the status light."""

    OFF = 0
    RED = 1
    GREEN = 2
    AMBER = 3


@dataclass(frozen=True, slots=True)
class SciLights:
    """The lights.

    Attributes:
        dirt: the dirt detection light, blue.
        max: the light of the button MAX, green.
        clean: the light of the button CLEAN, green.
        spot: the light of the button SPOT, green.
        status: the two-coloured status light.
        power_colour: of the light of the button POWER: 0 green .. 255 red.
        power_intensity: of the same: 0 off .. 255 full.
    """

    dirt: bool = False
    max: bool = False
    clean: bool = False
    spot: bool = False
    status: StatusLed = StatusLed.OFF
    power_colour: int = 0
    power_intensity: int = 0

    def encode(self) -> bytes:
        """Return the command that sets all lights.

        Raises:
            ArgumentError: a power colour or intensity outside 0..255.
        """
        colour = _within("power colour", self.power_colour, 0, 255)
        intensity = _within("power intensity", self.power_intensity, 0, 255)
        lamps = bits(self.dirt, self.max, self.clean, self.spot) | self.status << 4
        return bytes([Op.LEDS, lamps, colour, intensity])


def _within(what: str, value: int, low: int, high: int) -> int:
    if not low <= value <= high:
        raise ArgumentError(f"SCI: {what} must be {low}..{high}, not {value}")
    return value


def drive(velocity_mm_s: int, radius_mm: int = STRAIGHT) -> bytes:
    """Encode Drive.

    Args:
        velocity_mm_s: mean of the wheels' speeds, -500..500; where it turns in place, each wheel's speed.
        radius_mm: from the turning point to the Roomba's middle, -2000..2000 without 0; a positive one lies to the
            left. STRAIGHT, CLOCKWISE and COUNTER_CLOCKWISE have their own meaning.

    Raises:
        ArgumentError: a number outside its range.
    """
    _within("velocity in mm/s", velocity_mm_s, -MAX_SPEED_MM_S, MAX_SPEED_MM_S)
    if radius_mm != STRAIGHT:
        _within("radius in mm", radius_mm, -MAX_RADIUS_MM, MAX_RADIUS_MM)
    if radius_mm == 0:
        raise ArgumentError("SCI: a radius of 0 mm has no meaning; 1 and -1 turn in place")
    return struct.pack(">Bhh", Op.DRIVE, velocity_mm_s, radius_mm)


def wheel_speeds_m_s(velocity_mm_s: int, radius_mm: int, wheelbase_m: float = WHEELBASE_M) -> tuple[float, float]:
    """Return the speeds of the left and the right wheel that Drive means; see `drive` for its arguments.

    Where a wheel would have to go faster than it can, in a narrow curve, both go slower.
    """
    if radius_mm == STRAIGHT:
        left = right = 1.0
    elif radius_mm in (CLOCKWISE, COUNTER_CLOCKWISE):
        left, right = -float(radius_mm), float(radius_mm)
    else:
        half = wheelbase_m / 2 / (radius_mm / 1000)
        left, right = 1 - half, 1 + half
    speed_m_s, most_m_s = velocity_mm_s / 1000, MAX_SPEED_MM_S / 1000
    fastest_m_s = max(abs(left), abs(right)) * abs(speed_m_s)
    scale = min(1.0, most_m_s / fastest_m_s) if fastest_m_s else 1.0
    return left * speed_m_s * scale, right * speed_m_s * scale


def song(number: int, notes: Sequence[tuple[int, int]]) -> bytes:
    """Encode Song: store a song.

    Args:
        number: of the song, 0..15.
        notes: 1..16 pairs of MIDI note, 31..127 or 0 for a rest, and duration in 1/64 s, 0..255.

    Raises:
        ArgumentError: a number outside its range.
    """
    _within("song number", number, 0, SONGS - 1)
    _within("count of notes", len(notes), 1, MAX_NOTES)
    data = bytearray([Op.SONG, number, len(notes)])
    for note, duration in notes:
        data += bytes([note and _within("note", note, 31, 127), _within("duration in 1/64 s", duration, 0, 255)])
    return bytes(data)


def play(number: int) -> bytes:
    """Encode Play.

    Raises:
        ArgumentError: a song number outside 0..15.
    """
    return bytes([Op.PLAY, _within("song number", number, 0, SONGS - 1)])


def ask_sensors(group: int) -> bytes:
    """Encode Sensors: ask for a group.

    Raises:
        ArgumentError: a group outside 0..3.
    """
    return bytes([Op.SENSORS, _within("sensor group", group, 0, len(GROUP_BYTES) - 1)])


DATA_BYTES: Final = {Op.BAUD: 1, Op.DRIVE: 4, Op.MOTORS: 1, Op.LEDS: 3, Op.SONG: 2, Op.PLAY: 1, Op.SENSORS: 1}
"""Number of bytes after an op code; after Song, two more for each note."""
