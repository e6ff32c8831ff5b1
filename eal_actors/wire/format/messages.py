"""Messages between controllers and robots, as objects and as bytes: calls, replies, events and heartbeats.

A message is a pair: the envelope, msgpack in zenoh's attachment, and the payload, the unchanged bytes of an EALData, so
that an image is never copied into an envelope. Decoding any bytes returns a valid object or raises ProtocolError.
docs/reference/wire-format.md has the tables.

Thread: any; nothing here keeps state.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, TypeAlias, final

from eal_actors.device.data import EALData, Payload
from eal_actors.device.data.c_types import short_repr
from eal_actors.kernel.errors import EALError, ProtocolError, UnavailableError
from eal_actors.wire.format.packing import (
    CLIENT_BYTES,
    MAX_CALL_BYTES,
    MAX_PAYLOAD_BYTES,
    MAX_WORD,
    PROTOCOL_VERSION,
    Buffer,
    checked_client,
    checked_count,
    checked_payload,
    checked_row,
    checked_seconds,
    checked_text,
    checked_time,
    checked_word,
    data_from,
    data_header,
    error_body,
    error_from,
    hexadecimal,
    optional_data_from,
    optional_row,
    pack,
    packed_client,
    payload_of,
    shared_from,
    unpack,
    unpack_map,
)
from eal_actors.wire.shared_memory import SharedValue

_STATUS, _DATA, _ERROR, _FIELDS, _ACCEPTED = range(5)
_NO_PAYLOAD: Final = b""
_NO_TIME: Final = (None, None, None)
_READING: Final = int, bytes, int, int, float, float, type(None), list, type(None)
_COMMAND: Final = *_READING, str, float, float
"""Types of the fields of the usual calls; only their numbers and arguments need a further check."""
_NO_ECHO: Final = "", 0.0, 0.0
NO_PROOF: Final = *_NO_ECHO, ""
"""The last fields of a call that has no echo, and those of its header from `era` on without tracing."""
_ARGUMENTS: Final = frozenset({str, int})
_USUAL_REPLIES: Final = frozenset({(int, int, int, list, str, float), (int, int, int, int, str, float)})
"""The same of the usual replies: a value or an error, and a status."""


class CallId(NamedTuple):
    """Identifier of a call, unique over all controllers and their restarts.

    Attributes:
        client: the controller's process; see keys.client_id.
        epoch: number of the client's connection to the robot.
        sequence: number of the client's call to the robot, from 1.
    """

    client: str
    epoch: int
    sequence: int


Arguments: TypeAlias = tuple[str | int, ...]
"""The str and int arguments of a method in order; ints have at most 64 bits."""


class CallHeader(NamedTuple):
    """Fields of a call other than its key and its value; the first three are those of CallId.

    Attributes:
        ttl_s: time to live: real seconds after the sending within which the robot may begin.
        deadline_s: real seconds from the sending to the caller's deadline; negative once it has passed.
        start_s: time to begin, by the robot's clock, in seconds; None for at once.
        era: of a command, as the next two the proof of its age, see freshness: the run of the robot's server that the
            echo is from.
        echo_s: reading of the robot's clock in one of its replies.
        held_s: seconds by the controller's clock from the arrival of that reply to the sending.
        traceparent: span of the call in the format of W3C Trace Context; empty without tracing.
    """

    client: str
    epoch: int
    sequence: int
    ttl_s: float
    deadline_s: float
    start_s: float | None = None
    arguments: Arguments = ()
    era: str = ""
    echo_s: float = 0.0
    held_s: float = 0.0
    traceparent: str = ""

    @property
    def call_id(self) -> CallId:
        """Identifier of the call."""
        return tuple.__new__(CallId, self[:3])  # CallId() takes several times as long


@final
class Accepted:
    """Answer to a long command: it has begun, and its outcome follows as an event."""

    def __repr__(self) -> str:
        return "ACCEPTED"


ACCEPTED: Final = Accepted()

Answer: TypeAlias = int | EALData | EALError | dict[str, Any] | Accepted
"""A status; a value; an error; fields by name (of `hello`, `ping` and `reattach`); or ACCEPTED."""


class RobotTime(NamedTuple):
    """Reading of a robot's clock in one run of its server, in seconds.

    `began_s` is when the answered command began, by the same clock, if it had a start time.
    """

    era: str
    time_s: float
    began_s: float | None = None


class CallReply(NamedTuple):
    """Reply to a call, whose number is 0 if the robot could not decode it; `time` is when it answered, if included."""

    sequence: int
    answer: Answer
    time: RobotTime | None = None


TakeShared: TypeAlias = Callable[[SharedValue], Payload]
"""Takes a value out of shared memory; see ValueMemory.take."""


@dataclass(frozen=True, slots=True)
class RobotEvent:
    """Event that a robot publishes to all its controllers; readers ignore unknown kinds.

    `stamp_s` is when it happened, by the robot's clock as in replies, in seconds. `answer` is the outcome of `call`.
    """

    kind: str
    stamp_s: float
    call: CallId | None = None
    answer: Answer | None = None
    fields: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """Heartbeat of a controller; see CallId for `client`. `name` is for people, such as `anna@lab-pc`."""

    client: str
    name: str = ""


def encode_call(header: CallHeader, data: EALData | None = None) -> tuple[bytes, Payload]:
    """Return a call's envelope and payload; DataError if this is over MAX_CALL_BYTES, or a field has no form."""
    return encode_fields(*header[:7], header[7:], data)


def encode_fields(
    client: str,
    epoch: int,
    sequence: int,
    ttl_s: float,
    deadline_s: float,
    start_s: float | None,
    arguments: Arguments,
    proof: tuple[str, float, float, str],
    data: EALData | None,
) -> tuple[bytes, Payload]:
    """Do the same with the fields of a header, of which `proof` are those from `era` on, without making one."""
    about = None if data is None else data_header(data)
    row = [PROTOCOL_VERSION, packed_client(client), epoch, sequence, ttl_s, deadline_s, start_s, arguments, about]
    if proof is not NO_PROOF and proof != NO_PROOF:
        *echo, traceparent = proof
        row += echo
        if traceparent:
            row += False, traceparent  # the first is a field of older releases
    return pack(row, "call"), _NO_PAYLOAD if data is None else payload_of(data, MAX_CALL_BYTES)


def decode_call(envelope: Buffer, payload: Buffer = _NO_PAYLOAD) -> tuple[CallHeader, EALData | None]:
    """Return the header and the value of a call; ProtocolError if the bytes are no call of this version."""
    row = unpack(envelope, "call")
    types = tuple(map(type, row)) if type(row) is list else ()
    if types == _READING:
        row += _NO_ECHO
        types = _COMMAND
    if types == _COMMAND and not payload and (header := _usual_header(row)) is not None:
        return header, None
    return _checked_call(row, payload)


def _usual_header(row: list[Any]) -> CallHeader | None:
    """Return the header of a call that changes nothing or a command, if it is as usual."""
    version, client, epoch, sequence, ttl_s, deadline_s, _, arguments, _, era, echo_s, held_s = row
    is_sound = version == PROTOCOL_VERSION and epoch >= 0 and sequence >= 0 and len(client) == CLIENT_BYTES
    is_plain = len(era) <= MAX_WORD and (not arguments or (len(arguments) == 1 and type(arguments[0]) is str))
    if not is_sound or not is_plain or not math.isfinite(ttl_s + deadline_s + echo_s + held_s):
        return None
    name, plain = hexadecimal(client), tuple(arguments)
    fields = name, epoch, sequence, ttl_s, deadline_s, None, plain, era, echo_s, held_s, ""
    return tuple.__new__(CallHeader, fields)  # CallHeader() takes several times as long


def _checked_call(row: object, payload: Buffer) -> tuple[CallHeader, EALData | None]:
    """Return the header and the value of any call, as decode_call does."""
    row = optional_row(row, "call", 9, 5)
    _, client, epoch, sequence, ttl_s, deadline_s, start_s, arguments, about, era, echo_s, held_s, _, parent = row
    if type(arguments) is not list or not _ARGUMENTS.issuperset(map(type, arguments)):
        raise ProtocolError(f"call: arguments {short_repr(arguments)} are not a list of texts and ints")
    header = CallHeader(
        checked_client(client, "call"),
        checked_count(epoch, "call: epoch"),
        checked_count(sequence, "call: sequence"),
        checked_seconds(ttl_s, "call: ttl_s"),
        checked_seconds(deadline_s, "call: deadline_s"),
        None if start_s is None else checked_time(start_s, "call: start_s"),
        tuple(arguments),
        "" if era is None else checked_word(era, "call: era"),
        0.0 if era is None else checked_time(echo_s, "call: echo_s"),
        0.0 if era is None else checked_time(held_s, "call: held_s"),
        "" if parent is None else checked_word(parent, "call: traceparent"),
    )
    return header, None if about is None and not payload else optional_data_from(about, payload, "call")


def encode_reply(
    reply: tuple[int, Answer, RobotTime | None], shared: SharedValue | None = None
) -> tuple[bytes, Payload]:
    """Return a reply's envelope and payload, which is empty if the value is in shared memory.

    Raises DataError if the payload is larger than MAX_PAYLOAD_BYTES, or a field cannot be packed.
    """
    sequence, answer, time = reply
    kind, body, payload = _answer_parts(answer)
    if shared is not None:
        return pack((PROTOCOL_VERSION, sequence, kind, body, *(time or _NO_TIME), shared), "answer"), _NO_PAYLOAD
    known = () if time is None else time[:2] if time[2] is None else time
    return pack((PROTOCOL_VERSION, sequence, kind, body, *known), "answer"), payload


def encode_status(sequence: int, status: int, era: str, time_s: float) -> bytes:
    """Return the envelope of a reply with a status, as encode_reply, in one step."""
    return pack((PROTOCOL_VERSION, sequence, _STATUS, status, era, time_s), "answer")


def encode_value(sequence: int, data: EALData, stamp_s: float | None, era: str, time_s: float) -> bytes:
    """Return the envelope of a reply with a value whose time is `stamp_s`, as encode_reply, in one step."""
    c_type, _, shape, unit, frame_id, _ = data.description
    body = c_type.full_name, shape, unit, frame_id, stamp_s
    return pack((PROTOCOL_VERSION, sequence, _DATA, body, era, time_s), "answer")


def decode_reply(envelope: Buffer, payload: Buffer = _NO_PAYLOAD, take: TakeShared | None = None) -> CallReply:
    """Return a reply, whose answer may be an error; ProtocolError if the bytes are no reply of this version.

    `take` returns a value in shared memory; UnavailableError, if it has gone, becomes the answer.
    """
    row = unpack(envelope, "answer")
    if type(row) is list and tuple(map(type, row)) in _USUAL_REPLIES:
        version, sequence, kind, body, era, time_s = row
        if version == PROTOCOL_VERSION and sequence >= 0 and math.isfinite(time_s):
            if kind == _DATA and type(payload) is bytes and len(payload) <= MAX_PAYLOAD_BYTES:
                answer: Answer = data_from(body, payload, "answer")
            else:
                answer = _answer_from(kind, body, payload, "answer")
            new = tuple.__new__  # CallReply() and RobotTime() take several times as long
            return new(CallReply, (sequence, answer, new(RobotTime, (era, time_s, None))))
    _, sequence, kind, body, era, time_s, began_s, shared = optional_row(row, "answer", 4, 4)
    time = None
    if era is not None:
        began_s = None if began_s is None else checked_time(began_s, "answer: began_s")
        time = RobotTime(checked_text(era, "answer: era"), checked_time(time_s, "answer: time_s"), began_s)
    sequence = checked_count(sequence, "answer: sequence")
    if shared is not None and take is not None:
        try:
            payload = take(shared_from(shared, "answer"))
        except UnavailableError as error:
            return CallReply(sequence, error, time)
    return CallReply(sequence, _answer_from(kind, body, payload, "answer"), time)


def encode_event(event: RobotEvent) -> tuple[bytes, Payload]:
    """Return an event's envelope and payload; DataError if this is over MAX_PAYLOAD_BYTES, or a field has no form."""
    fields: dict[str, Any] = {"version": PROTOCOL_VERSION, "kind": event.kind, "stamp_s": event.stamp_s}
    payload: Payload = _NO_PAYLOAD
    if event.call is not None:
        client, epoch, sequence = event.call
        fields["call"] = packed_client(client), epoch, sequence
    if event.answer is not None:
        kind, body, payload = _answer_parts(event.answer)
        fields["answer"] = kind, body
    if event.fields:
        fields["fields"] = dict(event.fields)
    return pack(fields, "event"), payload


def decode_event(envelope: Buffer, payload: Buffer = _NO_PAYLOAD) -> RobotEvent:
    """Return an event; ProtocolError if the bytes are no event of this version."""
    fields = unpack_map(envelope, "event")
    call, answer, more = fields.get("call"), fields.get("answer"), fields.get("fields", {})
    if type(more) is not dict:
        raise ProtocolError(f"event: fields {short_repr(more)} are no map")
    if call is not None:
        client, epoch, sequence = checked_row(call, "event: call", 3)
        epoch, sequence = checked_count(epoch, "event: call: epoch"), checked_count(sequence, "event: call: sequence")
        call = CallId(checked_client(client, "event: call"), epoch, sequence)
    if answer is None:
        optional_data_from(None, payload, "event")
    else:
        kind, body = checked_row(answer, "event: answer", 2)
        answer = _answer_from(kind, body, payload, "event: answer")
    return RobotEvent(
        checked_text(fields.get("kind"), "event: kind"),
        checked_time(fields.get("stamp_s"), "event: stamp_s"),
        call,
        answer,
        more,
    )


def encode_heartbeat(beat: Heartbeat) -> bytes:
    """Return a heartbeat's envelope; DataError if a field cannot be packed."""
    fields = {"version": PROTOCOL_VERSION, "client": packed_client(beat.client), "name": beat.name}
    return pack(fields, "heartbeat")


def decode_heartbeat(envelope: Buffer) -> Heartbeat:
    """Return a heartbeat; ProtocolError if the bytes are no heartbeat of this version."""
    fields = unpack_map(envelope, "heartbeat")
    return Heartbeat(
        checked_client(fields.get("client"), "heartbeat"), checked_text(fields.get("name", ""), "heartbeat: name")
    )


def _answer_parts(answer: Answer) -> tuple[int, Any, Payload]:
    if type(answer) is EALData:
        return _DATA, data_header(answer), payload_of(answer)
    if isinstance(answer, int):
        return _STATUS, int(answer), _NO_PAYLOAD  # True is a status too
    if isinstance(answer, EALError):
        return _ERROR, error_body(answer), _NO_PAYLOAD
    if isinstance(answer, dict):
        return _FIELDS, answer, _NO_PAYLOAD
    return _ACCEPTED, None, _NO_PAYLOAD


def _answer_from(kind: object, body: Any, payload: Buffer, what: str) -> Answer:
    if type(kind) is int:
        if kind == _DATA:
            return data_from(body, checked_payload(payload, what), what)
        if payload:
            optional_data_from(None, payload, what)
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
