"""Parts: a call that does not fit into one batch of the engine's link, sent as several messages with its key.

The engine would cut it up itself, but its collection of the pieces has no useful bound. It keeps one message for each
priority of each link, each piece keeps a receive buffer of 48 to 64 kB, however short it is, and access control looks
at whole messages only. With zenoh 1.10, seven messages of 10 MB at once took a robot from 83 to 142 MB, and 5,000
pieces of one byte to 125 MB. So robots refuse the engine's pieces. Access control checks each part, and PartStore
bounds those of all senders together.

A part differs from a single message in its length: a list of five items.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from eal_actors.device.data import Payload
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import BusyError, ProtocolError
from eal_actors.wire.format.keys import ANYBODY, sender_of
from eal_actors.wire.format.packing import (
    MAX_CALL_BYTES,
    MAX_ENVELOPE_BYTES,
    PROTOCOL_VERSION,
    Buffer,
    checked_count,
    pack,
    unpack,
    unpack_row,
)

PART_BYTES: Final = 44 * 1024
"""Bytes of a part. With its key it fits into a batch of 48 kB, the engine's smallest, which TLS links have."""
MAX_BYTES: Final = MAX_CALL_BYTES + MAX_ENVELOPE_BYTES
"""Limit of the unfinished calls of one certificate, and so of one call."""
MAX_TOTAL_BYTES: Final = 2 * MAX_BYTES
"""Limit of all unfinished calls."""
MAX_AGE_S: Final = 10.0
"""Real seconds after its first part in which a call must be complete."""

BEGINS_PART: Final = b"\x95"
"""First byte of the envelope of a part: a list of five."""


def split(envelope: bytes, payload: Payload) -> Iterator[tuple[bytes, Payload]]:
    """Yield the envelope and the payload of each message of a call: its own, or those of its parts if it is large."""
    if len(envelope) + len(payload) <= PART_BYTES:
        yield envelope, payload
        return
    fields, content = unpack(envelope, "call"), b"".join((envelope, payload))
    number = 0 if len(fields) == 2 else fields[3]  # 0 for a batch: its sender sends one after another
    for offset in range(0, len(content), PART_BYTES):
        row = PROTOCOL_VERSION, number, offset, len(content), len(envelope)
        yield pack(row, "part"), content[offset : offset + PART_BYTES]


@dataclass(slots=True)
class _Unfinished:
    """Call of which some parts are missing.

    Its content grows with its parts, although its size is known: a sender that only ever begins calls would cost a
    buffer of `total` bytes for each short message, and delay everything behind it in the reader's thread.
    """

    total: int
    envelope_bytes: int
    end_s: float
    content: bytearray = field(default_factory=bytearray)

    @property
    def room(self) -> int:
        """Memory that it counts for: at least a part's, so that tiny calls cannot be many."""
        return max(self.total, PART_BYTES)


class PartStore:
    """Collects the parts of calls, of a limited number of bytes. Thread: one."""

    def __init__(self, clock: Clock = REAL_TIME) -> None:
        self._clock = clock
        self._unfinished: dict[tuple[str, int], _Unfinished] = {}

    @property
    def held_bytes(self) -> int:
        """Memory that all unfinished calls may take."""
        return sum(call.room for call in self._unfinished.values())

    def add(self, key: str, envelope: Buffer, payload: Buffer) -> tuple[bytes, Payload] | None:
        """Add a part; return the envelope and the payload of its call if it is complete.

        Later parts of a call that was refused are ignored. Raises ProtocolError if it is no part, and BusyError if it
        is the first one, and other calls take the memory.
        """
        _, *fields = unpack_row(envelope, "part", 5)
        number, offset, total, envelope_bytes = (checked_count(field, "part") for field in fields)
        if not envelope_bytes <= total <= MAX_BYTES or not 0 < len(payload) <= total - offset:
            raise ProtocolError(f"part: {len(payload)} bytes at {offset} of {total}, {envelope_bytes} in the envelope")
        place = key, number
        if offset == 0:
            first = _Unfinished(total, envelope_bytes, self._clock.now() + MAX_AGE_S)
            self._make_room(key, first)
            self._unfinished[place] = first
        call = self._unfinished.get(place)
        if call is None or len(call.content) != offset or call.total != total:
            self._unfinished.pop(place, None)
            return None
        call.content += payload
        if len(call.content) < total:
            return None
        del self._unfinished[place]
        whole = memoryview(call.content).toreadonly()
        return bytes(whole[: call.envelope_bytes]), whole[call.envelope_bytes :]

    def _make_room(self, key: str, call: _Unfinished) -> None:
        """Forget calls that took too long; BusyError if there is no room for another one."""
        now_s = self._clock.now()
        self._unfinished = {place: it for place, it in self._unfinished.items() if now_s < it.end_s}
        caller = sender_of(key)
        own = sum(it.room for (other, _), it in self._unfinished.items() if sender_of(other) == caller)
        most = MAX_TOTAL_BYTES if caller == ANYBODY else MAX_BYTES
        if own + call.room > most or self.held_bytes + call.room > MAX_TOTAL_BYTES:
            raise BusyError("other large calls are on their way to the robot; call again, or one after another")


def number_of(envelope: Buffer) -> int:
    """Return the number of a part's call; ProtocolError if it is no part."""
    return checked_count(unpack_row(envelope, "part", 2)[1], "part")
