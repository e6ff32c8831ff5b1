"""The sensor packets of the Open Interface: bytes in, numbers out, and back.

Source: iRobot Create 2 Open Interface specification, based on the Roomba 600.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Final

from eal_actors.plugin import DataError

BUMPS_AND_DROPS: Final = 7
WALL: Final = 8
CLIFFS: Final = (9, 10, 11, 12)
"""Left, front left, front right, right."""
VIRTUAL_WALL: Final = 13
OVERCURRENTS: Final = 14
BUTTONS: Final = 18
DISTANCE: Final = 19
ANGLE: Final = 20
CHARGING_STATE: Final = 21
VOLTAGE: Final = 22
CURRENT: Final = 23
TEMPERATURE: Final = 24
CHARGE: Final = 25
CAPACITY: Final = 26
CLIFF_SIGNALS: Final = (28, 29, 30, 31)
OI_MODE: Final = 35
SONG_NUMBER: Final = 36
SONG_PLAYING: Final = 37
STREAM_PACKETS: Final = 38
REQUESTED_VELOCITY: Final = 39
REQUESTED_RADIUS: Final = 40
REQUESTED_RIGHT: Final = 41
REQUESTED_LEFT: Final = 42
LEFT_COUNTS: Final = 43
RIGHT_COUNTS: Final = 44
STASIS: Final = 58
CONTACTS_GROUP: Final = 1
POWER_GROUP: Final = 3

_SIGNED_BYTES: Final = {TEMPERATURE}
_SIGNED_WORDS: Final = {DISTANCE, ANGLE, CURRENT, *range(39, 43), *range(54, 58)}
_WORDS: Final = {VOLTAGE, CHARGE, CAPACITY, *range(27, 32), 33, LEFT_COUNTS, RIGHT_COUNTS, *range(46, 52)}


def _form(packet: int) -> str:
    if packet in _SIGNED_BYTES:
        return "b"
    if packet in _SIGNED_WORDS:
        return "h"
    return "H" if packet in _WORDS else "B"


FORMS: Final = MappingProxyType({packet: _form(packet) for packet in range(7, 59)})
"""Of each packet, its form as `struct` writes it; big-endian."""

GROUPS: Final = MappingProxyType(
    {
        0: range(7, 27),
        1: range(7, 17),
        2: range(17, 21),
        3: range(21, 27),
        4: range(27, 35),
        5: range(35, 43),
        6: range(7, 43),
        100: range(7, 59),
        101: range(43, 59),
        106: range(46, 52),
        107: range(54, 59),
    }
)
"""The packets of each group."""

BUTTON_NAMES: Final = ("clean", "spot", "dock", "minute", "hour", "day", "schedule", "clock")
"""The buttons in the order of their bits."""

STREAM_HEADER: Final = 19


def packets_of(number: int) -> Sequence[int]:
    """Return the packets of a number: those of a group, or the single one.

    Raises:
        DataError: there is no such packet.
    """
    if number in FORMS:
        return (number,)
    if number not in GROUPS:
        raise DataError(f"OI: there is no sensor packet {number}")
    return GROUPS[number]


def size_of(packet: int) -> int:
    """Return the size of a packet in bytes."""
    return struct.calcsize(f">{FORMS[packet]}")


def encode(packet: int, value: int) -> bytes:
    """Return a packet's bytes; a value out of range is clamped."""
    bits = 8 * size_of(packet)
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if FORMS[packet].islower() else (0, (1 << bits) - 1)
    return struct.pack(f">{FORMS[packet]}", max(low, min(high, value)))


def decode(packets: Iterable[int], data: bytes) -> dict[int, int]:
    """Decode consecutive packets.

    Raises:
        DataError: the bytes are too few or too many.
    """
    wanted = tuple(packets)
    form = ">" + "".join(FORMS[packet] for packet in wanted)
    if len(data) != struct.calcsize(form):
        raise DataError(f"OI: these {len(wanted)} packets have {struct.calcsize(form)} bytes, not {len(data)}")
    return dict(zip(wanted, struct.unpack(form, data), strict=True))


def stream_frame(values: Mapping[int, int], numbers: Iterable[int] | None = None) -> bytes:
    """Return a frame of the stream: header, length, the packets or groups, each after its number, and a checksum.

    `numbers` are those of packets and groups; None for the packets of `values`.
    """
    body = b"".join(
        bytes([number]) + b"".join(encode(packet, values[packet]) for packet in packets_of(number))
        for number in (values if numbers is None else numbers)
    )
    frame = bytes([STREAM_HEADER, len(body)]) + body
    return frame + bytes([-sum(frame) & 0xFF])


class StreamReader:
    """Finds frames in the Roomba's output, in pieces of any size, and skips the rest.

    Args:
        numbers: of the packets and groups of each frame; if None, any frame is accepted. A false header announces up
            to 255 bytes, which would hold the frames after it back.

    Attributes:
        skipped: number of bytes outside frames.
    """

    def __init__(self, numbers: Iterable[int] | None = None) -> None:
        self.skipped = 0
        self._length = None if numbers is None else sum(1 + sum(map(size_of, packets_of(n))) for n in numbers)
        self._held = bytearray()

    def feed(self, data: bytes) -> list[dict[int, int]]:
        """Process bytes; return the completed frames."""
        self._held += data
        frames: list[dict[int, int]] = []
        while self._held:
            start = self._held.find(STREAM_HEADER)
            self._skip(len(self._held) if start < 0 else start)
            if len(self._held) < 2:
                break
            size, is_wanted = self._held[1] + 3, self._length in (None, self._held[1])
            if is_wanted and len(self._held) < size:
                break
            values = _values(bytes(self._held[:size])) if is_wanted else None
            if values is None:
                self._skip(1)  # a false header within other data
            else:
                frames.append(values)
                del self._held[:size]
        return frames

    def _skip(self, count: int) -> None:
        self.skipped += count
        del self._held[:count]


def _values(frame: bytes) -> dict[int, int] | None:
    """Return the values of a frame; None if it is invalid."""
    if sum(frame) & 0xFF:
        return None
    body, place, values = frame[2:-1], 0, {}
    while place < len(body):
        number, place = body[place], place + 1
        if number not in FORMS and number not in GROUPS:
            return None
        for packet in packets_of(number):
            if place + size_of(packet) > len(body):
                return None
            (values[packet],) = struct.unpack_from(f">{FORMS[packet]}", body, place)
            place += size_of(packet)
    return values
