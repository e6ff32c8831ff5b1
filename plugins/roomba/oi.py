"""The commands of the Open Interface: encoding of bytes.

Drive, Song, Play and most op codes are those of the older Serial Command Interface, see sci.py.

Source: iRobot Create 2 Open Interface specification, based on the Roomba 600.
"""

from __future__ import annotations

import enum
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from eal_actors.plugin import ArgumentError

from .groups import bits
from .packets import FORMS, GROUPS
from .sci import Mode

BAUD_RATE: Final = 115200
STREAM_PERIOD_S: Final = 0.015
WHEELBASE_M: Final = 0.235
METRES_A_COUNT: Final = math.pi * 0.072 / 508.8
"""Travel of a wheel of 72 mm in one of the 508.8 counts of its encoder."""
COUNTS: Final = 1 << 16
"""Counts of an encoder before it wraps."""
SONGS: Final = 4
MAX_SPEED_MM_S: Final = 500
MODES: Final = (Mode.OFF, Mode.PASSIVE, Mode.SAFE, Mode.FULL)
"""The modes in the order of their numbers in sensor packet 35."""


class OiOp(enum.IntEnum):
    """The op codes that the older interface lacks or defines differently."""

    RESET = 7
    PWM_MOTORS = 144
    DRIVE_DIRECT = 145
    DRIVE_PWM = 146
    STREAM = 148
    QUERY_LIST = 149
    STREAM_ON = 150
    SCHEDULING_LEDS = 162
    DIGITS_RAW = 163
    DIGITS_ASCII = 164
    PUSH_BUTTONS = 165
    SCHEDULE = 167
    SET_TIME = 168
    STOP = 173


@dataclass(frozen=True, slots=True)
class OiLights:
    """The lights.

    Attributes:
        debris: the blue debris light.
        spot: the green light of SPOT.
        dock: the green light of DOCK.
        check_robot: the orange light for a fault.
        power_colour: of the light of the button CLEAN: 0 green .. 255 red.
        power_intensity: of the same: 0 off .. 255 full.
    """

    debris: bool = False
    spot: bool = False
    dock: bool = False
    check_robot: bool = False
    power_colour: int = 0
    power_intensity: int = 0

    def encode(self) -> bytes:
        """Return the command that sets all lights.

        Raises:
            ArgumentError: a power colour or intensity outside 0..255.
        """
        for what, level in (("colour", self.power_colour), ("intensity", self.power_intensity)):
            if not 0 <= level <= 255:
                raise ArgumentError(f"OI: the power light's {what} must be 0..255, not {level}")
        lamps = bits(self.debris, self.spot, self.dock, self.check_robot)
        return bytes([139, lamps, self.power_colour, self.power_intensity])


def drive_direct(left_mm_s: int, right_mm_s: int) -> bytes:
    """Encode Drive Direct; on the wire the right wheel comes first.

    Raises:
        ArgumentError: a speed outside -500..500.
    """
    for side, speed_mm_s in (("left", left_mm_s), ("right", right_mm_s)):
        if abs(speed_mm_s) > MAX_SPEED_MM_S:
            raise ArgumentError(f"OI: the {side} wheel's speed in mm/s must be -500..500, not {speed_mm_s}")
    return struct.pack(">Bhh", OiOp.DRIVE_DIRECT, right_mm_s, left_mm_s)


def stream(packets: Sequence[int]) -> bytes:
    """Encode Stream: request packets every 15 ms.

    Raises:
        ArgumentError: there is no such packet.
    """
    for packet in packets:
        if packet not in FORMS and packet not in GROUPS:
            raise ArgumentError(f"OI: there is no sensor packet {packet}")
    if len(packets) > 255:
        raise ArgumentError(f"OI: a list has 255 packets at most, not {len(packets)}")
    return bytes([OiOp.STREAM, len(packets), *packets])


def stream_on(*, on: bool) -> bytes:
    """Encode Pause/Resume Stream."""
    return bytes([OiOp.STREAM_ON, on])
