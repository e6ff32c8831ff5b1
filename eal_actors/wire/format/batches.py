"""Batches: several small calls to one process in one message, and their replies in another.

A message costs the engine and both processes several times as much as decoding the call in it. A batch has the key of
one of its messages, and the envelopes of all in its own envelope; it has no payload. It differs from a single message
in its length: a list of two items. A robot that takes batches names its process in the handshake; only those that sent
a batch get one.

Thread: any; nothing here keeps state.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from eal_actors.device.data import Payload
from eal_actors.kernel.errors import ProtocolError
from eal_actors.wire.format.packing import PROTOCOL_VERSION, Buffer, check_version, pack, unpack

MAX_ROWS: Final = 256
"""Limit of the messages in one batch."""
MAX_ROW_BYTES: Final = 1024
"""Largest payload of a message that is put into a batch."""
MAX_BATCH_BYTES: Final = 32 * 1024
"""Bytes from which a batch is full, so that it seldom needs parts."""

BEGINS_BATCH: Final = b"\x92"
"""First byte of the envelope of a batch: a list of two."""


def encode_batch(rows: Sequence[tuple[str | Payload, ...]]) -> bytes:
    """Return the envelope of a batch; DataError if the rows are too large together.

    The row of a call is the robot, the resource, the method, the envelope and the payload; that of a reply has the
    robot, the envelope and the payload.
    """
    return pack((PROTOCOL_VERSION, rows), "batch")


def decode_batch(envelope: Buffer, names: int) -> list[list[Any]]:
    """Return the rows of a batch: `names` texts each, the envelope and the payload; ProtocolError if it is no batch."""
    version, rows = unpack(envelope, "batch")
    check_version(version, "batch")
    if type(rows) is not list or not 0 < len(rows) <= MAX_ROWS:
        raise ProtocolError(f"batch: not a list of 1 to {MAX_ROWS} messages")
    types = [str] * names + [bytes, bytes]
    for row in rows:
        if type(row) is not list or list(map(type, row)) != types:
            raise ProtocolError(f"batch: a message is not {names} texts, an envelope and a payload")
    return rows
