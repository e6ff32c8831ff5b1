"""The most frequent messages in one step.

They are a call that changes nothing, a command without a value or a start time, and a reply with a value or a status.
Their bytes are those of encode_call and encode_reply, without the objects that these take.

Thread: any; nothing here keeps state.
"""

from __future__ import annotations

from eal_actors.device.data import EALData
from eal_actors.wire.format.messages import DATA, STATUS, Arguments, CallId
from eal_actors.wire.format.packing import PROTOCOL_VERSION, pack, packed_client


def encode_reading(
    client: str, epoch: int, sequence: int, left_s: float, arguments: Arguments, traceparent: str
) -> bytes:
    """Return the envelope of a call that changes nothing, as encode_call; DataError if a field cannot be packed.

    `left_s` are the seconds until its deadline, which are its time to live too.
    """
    row = [PROTOCOL_VERSION, packed_client(client), epoch, sequence, left_s, left_s, None, arguments, None]
    if traceparent:
        row += "", 0.0, 0.0, False, traceparent
    return pack(row, "call")


def encode_command(
    call_id: CallId,
    ttl_s: float,
    left_s: float,
    arguments: Arguments,
    proof: tuple[str, float, float],
    traceparent: str,
) -> bytes:
    """Return the envelope of a command, as encode_call; DataError if a field cannot be packed.

    `left_s` are the seconds until its deadline, `proof` its era, echo_s and held_s; see CallHeader.
    """
    client, epoch, sequence = call_id
    row = [PROTOCOL_VERSION, packed_client(client), epoch, sequence, ttl_s, left_s, None, arguments, None, *proof]
    if traceparent:
        row += False, traceparent
    return pack(row, "call")


def encode_status(sequence: int, status: int, era: str, time_s: float) -> bytes:
    """Return the envelope of a reply with a status, as encode_reply; see encode_value."""
    return pack((PROTOCOL_VERSION, sequence, STATUS, status, era, time_s), "answer")


def encode_value(sequence: int, data: EALData, stamp_s: float | None, era: str, time_s: float) -> bytes:
    """Return the envelope of a reply with a value, as encode_reply; DataError if a field cannot be packed.

    `stamp_s` is the time of the value by the robot's clock.
    """
    c_type, _, shape, unit, frame_id, _ = data.description
    body = c_type.full_name, shape, unit, frame_id, stamp_s
    return pack((PROTOCOL_VERSION, sequence, DATA, body, era, time_s), "answer")
