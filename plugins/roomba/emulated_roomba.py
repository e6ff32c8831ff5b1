"""The common base of the emulators: command parsing, modes, reflexes, wheels, songs and sleep."""

from __future__ import annotations

import math
import struct
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, Final

from .bodies import RoombaBody
from .groups import PowerGroup
from .sci import (
    BAUD_PAUSE_S,
    BAUD_RATES,
    MAX_NOTES,
    MAX_RADIUS_MM,
    MAX_SPEED_MM_S,
    NO_OP_CODE,
    STRAIGHT,
    Mode,
    Op,
    wheel_speeds_m_s,
)

AWAKE: Final = frozenset({Mode.PASSIVE, Mode.SAFE, Mode.FULL})
CONTROLLED: Final = frozenset({Mode.SAFE, Mode.FULL})
LEADS_TO: Final[Mapping[int, Mode]] = MappingProxyType(
    {
        Op.START: Mode.PASSIVE,
        Op.CONTROL: Mode.SAFE,
        Op.SAFE: Mode.SAFE,
        Op.FULL: Mode.FULL,
        **dict.fromkeys((Op.POWER, Op.SPOT, Op.CLEAN, Op.MAX), Mode.PASSIVE),
    }
)
"""The mode that each op code common to both interfaces leads to."""
_ROUNDING_S: Final = 1e-9
_KEPT: Final = 100
_WAKES_IN_S: Final = 0.5


class Counter:
    """A count in whole units since its last reading; fractions stay for the next one.

    Args:
        total: the total count, in any unit.
    """

    def __init__(self, total: float) -> None:
        self._taken = total

    def take(self, total: float) -> int:
        """Return the units since the last call, clamped to 16 bits, from the total count."""
        since = math.trunc(round(total - self._taken, 6))
        self._taken += since
        return clamped(since, 16)


class EmulatedRoomba(ABC):
    """The byte-level state machine.

    Args:
        mode_pause_s: it ignores input for this time after a mode change; 0 if the bytes come through an operating
            system, with its unknown delays.
        has_device_detect: whether its line for waking it is connected, see `device_detect`. If not, as on a
            pseudo-terminal, Start wakes it.

    Attributes:
        violations: bytes lost during pauses.
        refused: number of commands that were invalid, or not allowed in its mode.
        complaints: the latest invalid commands.
        songs: the notes of each stored song.
        pressed: the pressed buttons; a test or a simulation sets them.
        brushes: the cleaning motors: side brush, vacuum, main brush.

    Thread: its owner's; none of it blocks.
    """

    data_bytes: ClassVar[Mapping[int, int]]
    """Number of bytes after each known op code; see `_more_bytes`."""
    accepted_in: ClassVar[Mapping[int, frozenset[Mode]]]
    """The modes that accept an op code; default: safe and full."""
    leads_to: ClassVar[Mapping[int, Mode]]
    """The op codes that change its mode."""
    usual_baud_rate: ClassVar[int]
    most_songs: ClassVar[int]
    baud_keeps_mode: ClassVar[bool] = False
    """Whether Baud keeps the mode; otherwise it leads to passive mode."""
    straight: ClassVar[frozenset[int]] = frozenset({STRAIGHT})
    """The radii that mean straight ahead."""
    wheelbase_m: float

    def __init__(self, body: RoombaBody, mode_pause_s: float, *, has_device_detect: bool = False) -> None:
        self.mode = Mode.OFF
        self.violations = 0
        self.refused = 0
        self.complaints: deque[str] = deque(maxlen=_KEPT)
        self.baud_rate = self.usual_baud_rate
        self.songs: dict[int, tuple[tuple[int, int], ...]] = {}
        self.pressed: frozenset[str] = frozenset()
        self.brushes = (False, False, False)
        self.is_asleep = False
        self._body = body
        self._mode_pause_s = mode_pause_s
        self._has_device_detect = has_device_detect
        self._low_since_s: float | None = None
        self._deaf_until_s = -math.inf
        self._waiting = bytearray()
        self._left_m_s = self._right_m_s = 0.0
        self._sings_until_s = -math.inf
        self._song: int | None = None

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Process bytes from the wire and return the reply.

        Args:
            data: any bytes, in pieces of any size.
            now_s: the time, which never goes backwards.
        """
        self.update()
        reply = bytearray()
        for byte in data:
            if self.is_asleep and (self._has_device_detect or byte != Op.START):
                continue
            self.is_asleep = False
            if now_s < self._deaf_until_s - _ROUNDING_S:
                self.violations += 1
                continue
            if not self._waiting and byte not in self.data_bytes:
                if byte != NO_OP_CODE:
                    self._refuse(f"byte {byte} is no op code")
                continue
            self._waiting.append(byte)
            if len(self._waiting) == self._wanted():
                op, values = self._waiting[0], bytes(self._waiting[1:])
                self._waiting.clear()
                reply += self._obey(op, values, now_s)
                self.update()
        return bytes(reply)

    def update(self) -> None:
        """In safe mode, end control at a wheel drop, or at a cliff during a forward motion."""
        if self.mode is not Mode.SAFE:
            return
        forward = self._left_m_s + self._right_m_s > 0
        if any(self._body.drops()) or (forward and any(self._body.cliffs())):
            self._enter(Mode.PASSIVE)

    def device_detect(self, *, low: bool, now_s: float) -> None:
        """Set the device detect line; low for half a second wakes the Roomba."""
        if not low and self._low_since_s is not None and now_s - self._low_since_s >= _WAKES_IN_S - _ROUNDING_S:
            self.is_asleep = False
        if low and self._low_since_s is None:
            self._low_since_s = now_s
        elif not low:
            self._low_since_s = None

    def _refuse(self, complaint: str) -> None:
        self.refused += 1
        self.complaints.append(complaint)

    def playing(self, now_s: float) -> int | None:
        """Return the number of the playing song, or None."""
        return self._song if now_s < self._sings_until_s else None

    def _wanted(self) -> int:
        """Return the length of the incoming command."""
        op = self._waiting[0]
        length = 1 + self.data_bytes[op]
        return length + self._more_bytes(op, self._waiting) if len(self._waiting) >= length else length

    def _more_bytes(self, op: int, begun: bytes | bytearray) -> int:
        """Return the number of further bytes of a command that contains its length."""
        return 2 * min(begun[2], MAX_NOTES) if op == Op.SONG else 0

    def _obey(self, op: int, data: bytes, now_s: float) -> bytes:
        if self.mode not in self.accepted_in.get(op, CONTROLLED):
            self.refused += 1  # no complaint: the driver cannot know the mode
            return b""
        if op in self.leads_to:
            self._enter(self.leads_to[op])
            self.is_asleep = op == Op.POWER
            self._deaf_until_s = now_s + self._mode_pause_s
        elif op == Op.PLAY:
            self._play(data[0], now_s)
        elif op == Op.BAUD:
            self._set_baud(data[0], now_s)
        elif op == Op.DRIVE:
            self._drive(*struct.unpack(">hh", data))
        elif op == Op.SONG:
            self._keep_song(data)
        elif op == Op.MOTORS:
            self.brushes = (bool(data[0] & 1), bool(data[0] & 2), bool(data[0] & 4))
        else:
            return self._execute(op, data, now_s)
        return b""

    @abstractmethod
    def _execute(self, op: int, data: bytes, now_s: float) -> bytes:
        """Execute a command specific to this interface; return the reply."""

    def _enter(self, mode: Mode) -> None:
        self.mode = mode
        if mode in (Mode.OFF, Mode.PASSIVE):
            self._rest()

    def _rest(self) -> None:
        """Switch all motors off."""
        self._set_wheels(0.0, 0.0)
        self.brushes = (False, False, False)

    def _set_wheels(self, left_m_s: float, right_m_s: float) -> None:
        self._left_m_s, self._right_m_s = left_m_s, right_m_s
        self._body.drive(left_m_s, right_m_s)

    def _drive(self, velocity_mm_s: int, radius_mm: int) -> None:
        if radius_mm in self.straight:
            radius_mm = STRAIGHT
        special = radius_mm == STRAIGHT
        if abs(velocity_mm_s) > MAX_SPEED_MM_S or radius_mm == 0 or (abs(radius_mm) > MAX_RADIUS_MM and not special):
            self._refuse(f"Drive at {velocity_mm_s} mm/s and {radius_mm} mm")
            return
        self._set_wheels(*wheel_speeds_m_s(velocity_mm_s, radius_mm, self.wheelbase_m))

    def _set_baud(self, code: int, now_s: float) -> None:
        if code >= len(BAUD_RATES):
            self._refuse(f"baud code {code}")
            return
        self.baud_rate = BAUD_RATES[code]
        if not self.baud_keeps_mode:
            self._enter(Mode.PASSIVE)
        if self._mode_pause_s:
            self._deaf_until_s = now_s + BAUD_PAUSE_S

    def _keep_song(self, data: bytes) -> None:
        number, notes = data[0], tuple(zip(data[2::2], data[3::2], strict=True))
        if number >= self.most_songs or not 1 <= data[1] <= MAX_NOTES:  # any note beyond 31..127 is a rest
            self._refuse(f"song {number} of {data[1]} notes")
            return
        self.songs[number] = notes

    def _play(self, number: int, now_s: float) -> None:
        if number not in self.songs or self.playing(now_s) is not None:
            self.refused += 1
            return
        self._song = number
        self._sings_until_s = now_s + sum(duration for _, duration in self.songs[number]) / 64


def clamped(value: float, bits: int) -> int:
    """Return the nearest integer that a signed number of that many bits can hold."""
    most = 1 << (bits - 1)
    return max(-most, min(most - 1, round(value)))


def power_of(body: RoombaBody) -> PowerGroup:
    """Return the state of a body's battery, in the units of the wire."""
    battery = body.battery()
    return PowerGroup(
        voltage_mv=max(0, clamped(battery.voltage_v * 1000, 17)),
        current_ma=clamped(battery.current_a * 1000, 16),
        temperature_c=clamped(battery.temperature_c, 8),
        charge_mah=max(0, clamped(battery.charge_ah * 1000, 17)),
        capacity_mah=max(0, clamped(battery.capacity_ah * 1000, 17)),
    )
