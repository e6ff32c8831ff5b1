"""The envelopes: a call, its answer, an event and a heartbeat as bytes and back. docs/network.md has the tables.

What is sent is a pair: the envelope, msgpack in zenoh's attachment, and the payload, the bytes of an EALData as they
are, so that a frame is never copied into an envelope. Whatever bytes arrive, decoding gives a valid object or
a ProtocolError.

Thread: any; nothing here keeps state.
"""

from __future__ import annotations

import math
from typing import Any, Final

from eal_actors.device.data import EALData, Payload
from eal_actors.device.data.c_types import short_repr
from eal_actors.device.data.storage import as_bytes
from eal_actors.kernel.errors import DataError, EALError, ProtocolError
from eal_actors.net.messages import (
    ACCEPTED,
    Accepted,
    Answer,
    CallHeader,
    CallId,
    Event,
    Heartbeat,
    Reply,
    ReplyTo,
    RobotTime,
)
from eal_actors.net.packing import (
    PROTOCOL_VERSION,
    Buffer,
    checked_row,
    data_from,
    data_header,
    error_body,
    error_from,
    pack,
    unpack_map,
    unpack_row,
)

__all__ = [
    "ACCEPTED",
    "MAX_PAYLOAD_BYTES",
    "PROTOCOL_VERSION",
    "Accepted",
    "Answer",
    "CallHeader",
    "CallId",
    "Event",
    "Heartbeat",
    "Reply",
    "ReplyTo",
    "RobotTime",
    "decode_call",
    "decode_event",
    "decode_heartbeat",
    "decode_reply",
    "encode_call",
    "encode_event",
    "encode_heartbeat",
    "encode_reply",
]

MAX_PAYLOAD_BYTES: Final = 64 * 1024**2

_CLIENT_BYTES: Final = 8
_STATUS, _DATA, _ERROR, _FIELDS, _ACCEPTED = range(5)
_NO_PAYLOAD: Final = b""


def encode_call(header: CallHeader, data: EALData | None = None) -> tuple[bytes, Payload]:
    """Return a call's envelope and payload.

    Raises:
        DataError: the payload is over MAX_PAYLOAD_BYTES, or something in the header cannot be sent.
    """
    client, epoch, sequence, ttl_s, deadline_s, start_s, arguments, *echo, has_more, traceparent = header
    about = None if data is None else data_header(data)
    row = [PROTOCOL_VERSION, _packed_client(client), epoch, sequence, ttl_s, deadline_s, start_s, arguments, about]
    if traceparent:
        row += (*echo, has_more, traceparent)
    elif has_more:
        row += (*echo, True)
    elif any(echo):
        row += echo
    return pack(row, "call"), _NO_PAYLOAD if data is None else _payload_of(data)


def decode_call(envelope: Buffer, payload: Buffer = _NO_PAYLOAD) -> tuple[CallHeader, EALData | None]:
    """Return the header and the value of a call.

    Raises:
        ProtocolError: it is none, or of another version.
    """
    row = unpack_row(envelope, "call", 9, 5)
    _, client, epoch, sequence, ttl_s, deadline_s, start_s, arguments, about, *echo, has_more, traceparent = row
    if type(arguments) is not list or any(type(item) not in (str, int) for item in arguments):
        raise ProtocolError(f"call: arguments {short_repr(arguments)} are not a list of texts and ints")
    header = CallHeader(
        _checked_client(client, "call"),
        _checked_count(epoch, "call: epoch"),
        _checked_count(sequence, "call: sequence"),
        _checked_seconds(ttl_s, "call: ttl_s"),
        _checked_seconds(deadline_s, "call: deadline_s"),
        None if start_s is None else _checked_time(start_s, "call: start_s"),
        tuple(arguments),
        *(("", 0.0, 0.0) if echo[0] is None else _echo_from(*echo)),
        has_more is not None and _checked_flag(has_more, "call: has_more"),
        "" if traceparent is None else _checked_text(traceparent, "call: traceparent"),
    )
    data = _data_of(about, payload, "call")
    return header, data


def encode_reply(reply: Reply) -> tuple[bytes, Payload]:
    """Return an answer's envelope and payload.

    Raises:
        DataError: the payload is over MAX_PAYLOAD_BYTES, or something in the answer cannot be sent.
    """
    kind, body, payload = _answer_parts(reply.answer)
    time = reply.time
    known = () if time is None else time[:2] if time.began_s is None else time
    return pack((PROTOCOL_VERSION, reply.sequence, kind, body, *known), "answer"), payload


def decode_reply(envelope: Buffer, payload: Buffer = _NO_PAYLOAD) -> Reply:
    """Return an answer, which may be an error, and what it belongs to.

    Raises:
        ProtocolError: it is none, or of another version.
    """
    _, sequence, *answer, era, time_s, began_s = unpack_row(envelope, "answer", 4, 3)
    time = None
    if era is not None:
        began_s = None if began_s is None else _checked_time(began_s, "answer: began_s")
        time = RobotTime(_checked_text(era, "answer: era"), _checked_time(time_s, "answer: time_s"), began_s)
    return Reply(_checked_count(sequence, "answer: sequence"), _answer_from(answer, payload, "answer"), time)


def encode_event(event: Event) -> tuple[bytes, Payload]:
    """Return an event's envelope and payload.

    Raises:
        DataError: the payload is over MAX_PAYLOAD_BYTES, or something in the event cannot be sent.
    """
    fields: dict[str, Any] = {"version": PROTOCOL_VERSION, "kind": event.kind, "stamp_s": event.stamp_s}
    payload: Payload = _NO_PAYLOAD
    if event.call is not None:
        client, epoch, sequence = event.call
        fields["call"] = _packed_client(client), epoch, sequence
    if event.answer is not None:
        kind, body, payload = _answer_parts(event.answer)
        fields["answer"] = kind, body
    if event.fields:
        fields["fields"] = dict(event.fields)
    return pack(fields, "event"), payload


def decode_event(envelope: Buffer, payload: Buffer = _NO_PAYLOAD) -> Event:
    """Return an event.

    Raises:
        ProtocolError: it is none, or of another version.
    """
    fields = unpack_map(envelope, "event")
    call, answer, more = fields.get("call"), fields.get("answer"), fields.get("fields", {})
    if type(more) is not dict:
        raise ProtocolError(f"event: fields {short_repr(more)} are no map")
    if answer is None:
        _data_of(None, payload, "event")
    return Event(
        _checked_text(fields.get("kind"), "event: kind"),
        _checked_time(fields.get("stamp_s"), "event: stamp_s"),
        None if call is None else _call_id_from(call),
        None if answer is None else _answer_from(checked_row(answer, "event: answer", 2), payload, "event: answer"),
        more,
    )


def encode_heartbeat(beat: Heartbeat) -> bytes:
    """Return a heartbeat's envelope; it has no payload.

    Raises:
        DataError: something in it cannot be sent.
    """
    client = _packed_client(beat.client)
    return pack(
        {
            "version": PROTOCOL_VERSION,
            "client": client,
            "epoch": beat.epoch,
            "sequence": beat.sequence,
            "name": beat.name,
        },
        "heartbeat",
    )


def decode_heartbeat(envelope: Buffer) -> Heartbeat:
    """Return a heartbeat.

    Raises:
        ProtocolError: it is none, or of another version.
    """
    fields = unpack_map(envelope, "heartbeat")
    return Heartbeat(
        _checked_client(fields.get("client"), "heartbeat"),
        _checked_count(fields.get("epoch"), "heartbeat: epoch"),
        _checked_count(fields.get("sequence"), "heartbeat: sequence"),
        _checked_text(fields.get("name", ""), "heartbeat: name"),
    )


def _answer_parts(answer: Answer) -> tuple[int, Any, Payload]:
    if isinstance(answer, EALData):
        return _DATA, data_header(answer), _payload_of(answer)
    if isinstance(answer, EALError):
        return _ERROR, error_body(answer), _NO_PAYLOAD
    if isinstance(answer, dict):
        return _FIELDS, answer, _NO_PAYLOAD
    if isinstance(answer, Accepted):
        return _ACCEPTED, None, _NO_PAYLOAD
    return _STATUS, int(answer), _NO_PAYLOAD  # True is a status too


def _answer_from(row: list[Any], payload: Buffer, what: str) -> Answer:
    kind, body = row
    if kind == _DATA and type(kind) is int:
        return data_from(body, _checked_payload(payload, what), what)
    _data_of(None, payload, what)
    if type(kind) is int:
        if kind == _STATUS and type(body) is int:
            return body
        if kind == _ERROR:
            return error_from(body, what)
        if kind == _FIELDS and type(body) is dict:
            return body
        if kind == _ACCEPTED and body is None:
            return ACCEPTED
    raise ProtocolError(
        f"{what}: {short_repr(body)} is not an answer of kind {short_repr(kind)}, which is 0 to {_ACCEPTED}"
    )


def _payload_of(data: EALData) -> Payload:
    if data.length > MAX_PAYLOAD_BYTES:
        raise DataError(f"a value of {data.length} bytes is over the {MAX_PAYLOAD_BYTES} that one message may carry")
    return data.payload


def _checked_payload(payload: Buffer, what: str) -> Payload:
    try:
        view = as_bytes(payload)
    except DataError as error:
        raise ProtocolError(f"{what}: {error.message}") from error
    if len(view) > MAX_PAYLOAD_BYTES:
        raise ProtocolError(f"{what}: a payload of {len(view)} bytes, more than {MAX_PAYLOAD_BYTES}")
    return view


def _data_of(header: object, payload: Buffer, what: str) -> EALData | None:
    if header is not None:
        return data_from(header, _checked_payload(payload, what), what)
    if len(_checked_payload(payload, what)):
        raise ProtocolError(f"{what}: a payload without a type")
    return None


def _echo_from(era: object, echo_s: object, held_s: object) -> tuple[str, float, float]:
    return (
        _checked_text(era, "call: era"),
        _checked_time(echo_s, "call: echo_s"),
        _checked_time(held_s, "call: held_s"),
    )


def _packed_client(client: str) -> bytes:
    try:
        packed = bytes.fromhex(client)
    except (ValueError, TypeError):
        packed = b""
    if len(packed) != _CLIENT_BYTES:
        raise DataError(f"client {short_repr(client)} is not {2 * _CLIENT_BYTES} hexadecimal digits")
    return packed


def _checked_client(client: object, what: str) -> str:
    if type(client) is not bytes or len(client) != _CLIENT_BYTES:
        raise ProtocolError(f"{what}: client {short_repr(client)} is not {_CLIENT_BYTES} bytes")
    return client.hex()


def _checked_count(count: object, what: str) -> int:
    if type(count) is not int or count < 0:
        raise ProtocolError(f"{what} {short_repr(count)} is not an int from 0")
    return count


def _checked_seconds(seconds: object, what: str) -> float:
    if type(seconds) not in (float, int) or seconds != seconds:
        raise ProtocolError(f"{what} {short_repr(seconds)} is no number of seconds")
    return float(seconds)  # type: ignore[arg-type]  # mypy does not follow `type(x) in`


def _checked_time(seconds: object, what: str) -> float:
    time_s = _checked_seconds(seconds, what)
    if not math.isfinite(time_s):
        raise ProtocolError(f"{what} {time_s} is no time")
    return time_s


def _checked_flag(flag: object, what: str) -> bool:
    if type(flag) is not bool:
        raise ProtocolError(f"{what} {short_repr(flag)} is no bool")
    return flag


def _checked_text(text: object, what: str) -> str:
    if type(text) is not str:
        raise ProtocolError(f"{what} {short_repr(text)} is no text")
    return text


def _call_id_from(row: object) -> CallId:
    client, epoch, sequence = checked_row(row, "event: call", 3)
    return CallId(
        _checked_client(client, "event: call"),
        _checked_count(epoch, "event: call: epoch"),
        _checked_count(sequence, "event: call: sequence"),
    )
