"""Stream frames and stream requests, as objects and as bytes; see docs/reference/wire-format.md.

A frame carries the age of its value, since the clocks of both ends differ. Decoding any bytes returns a valid frame or
raises an EALError; an image must have the size of its type header before it is decoded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, cast

from eal_actors.actors.feeds import StreamSpec
from eal_actors.device.data import EALData, Payload
from eal_actors.device.data.c_types import short_repr
from eal_actors.device.data.images import ENCODINGS, Encoding, decode_image, encode_image
from eal_actors.kernel.errors import DataError, EALError, ProtocolError, UnavailableError
from eal_actors.wire.format.messages import Arguments, RobotTime
from eal_actors.wire.format.packing import (
    MAX_PAYLOAD_BYTES,
    PROTOCOL_VERSION,
    Buffer,
    checked_client,
    checked_row,
    checked_text,
    checked_time,
    data_from,
    data_header,
    error_body,
    error_from,
    optional_row,
    pack,
    packed_client,
    shared_from,
    unpack,
)
from eal_actors.wire.shared_memory import SharedValue

LEASE_S: Final = 3.0
"""Real seconds for which a robot publishes to a reader that does not renew its request."""

_MAX_LEASE_MS: Final = 10_000
_DATA, _ERROR = 1, 2

Share = Callable[[Payload], Sequence[tuple[str, SharedValue | None]]]
"""Writes a payload into the memory of each reader; returns the reader and the place, None if there is no room."""


@dataclass(frozen=True, slots=True)
class StreamFrame:
    """Message of a stream: a value, or the error of reading it.

    `time` is the robot's clock when the frame was sent, `age_s` the age of the value at that time, in real seconds.
    """

    content: EALData | EALError
    time: RobotTime
    age_s: float = 0.0


def encode_frame(frame: StreamFrame, encoding: Encoding, share: Share = lambda _: ()) -> tuple[bytes, Payload]:
    """Return a frame's envelope and payload, which is empty if all readers find it in shared memory.

    Raises DataError if the value is larger than MAX_PAYLOAD_BYTES, or a field cannot be packed, UnsupportedError if
    OpenCV is not installed, and ResourceFaultError if the value cannot be encoded in this way.
    """
    content, payload = frame.content, cast("Payload", b"")
    kind, body = (_DATA, data_header(content)) if isinstance(content, EALData) else (_ERROR, error_body(content))
    if isinstance(content, EALData):
        if content.length > MAX_PAYLOAD_BYTES:
            limit = f"more than the {MAX_PAYLOAD_BYTES} that one message may carry"
            raise DataError(f"a value of {content.length} bytes cannot be streamed, {limit}")
        payload = content.payload if encoding == "raw" else encode_image(content, encoding)
    row = PROTOCOL_VERSION, kind, body, frame.time.era, frame.time.time_s, frame.age_s, encoding
    places = share(payload)
    shared = [(packed_client(client), *place) for client, place in places if place is not None]
    is_everywhere = len(shared) == len(places) > 0
    return pack((*row, shared) if shared else row, "frame"), b"" if is_everywhere else payload


def shared_place(envelope: Buffer, client: str) -> SharedValue | None:
    """Return where a reader finds a frame's payload in shared memory; ProtocolError if the bytes are no frame."""
    shared = optional_row(unpack(envelope, "frame"), "frame", 7, 1)[7]
    for row in shared if type(shared) is list else ():
        reader, *place = checked_row(row, "frame: shared memory", 5)
        if checked_client(reader, "frame: shared memory") == client:
            return shared_from(place, "frame")
    return None


def decode_frame(envelope: Buffer, payload: Buffer) -> StreamFrame:
    """Return a frame with its image decoded.

    Raises ProtocolError if it is none, UnsupportedError if OpenCV is missing, and UnavailableError if it was sent when
    the robot did not know this reader yet: all others have found it in shared memory.
    """
    _, kind, body, era, time_s, age_s, encoding, shared = optional_row(unpack(envelope, "frame"), "frame", 7, 1)
    if shared and not len(payload):
        raise UnavailableError("the newest value was for the readers before this one; the next one is for it too")
    time = RobotTime(checked_text(era, "frame: era"), checked_time(time_s, "frame: time_s"))
    if encoding not in ENCODINGS:
        raise ProtocolError(f"frame: there is no encoding {short_repr(encoding)}, only {', '.join(ENCODINGS)}")
    if kind == _ERROR:
        content: EALData | EALError = error_from(body, "frame")
    elif kind == _DATA and encoding == "raw":
        content = data_from(body, payload, "frame")
    elif kind == _DATA:
        content = data_from(body, decode_image(memoryview(payload), _image_shape(body), encoding), "frame")
    else:
        raise ProtocolError(f"frame: a kind {short_repr(kind)}, which is {_DATA} or {_ERROR}")
    return StreamFrame(content, time, checked_time(age_s, "frame: age_s"))


def _image_shape(header: object) -> tuple[int, ...]:
    shape = checked_row(header, "frame", 5)[1]
    is_image = type(shape) is list and len(shape) == 3 and all(type(size) is int and size > 0 for size in shape)
    if not is_image or math.prod(shape) > MAX_PAYLOAD_BYTES:
        raise ProtocolError(f"frame: the shape {short_repr(shape)} is none of an image")
    return tuple(shape)


# Requests.


def canonical(spec: StreamSpec) -> StreamSpec:
    """Return a spec with its rate rounded to the six digits of a key."""
    return StreamSpec(float(rate_text(spec)), spec.encoding)


def rate_text(spec: StreamSpec) -> str:
    """Return the rate as text for keys and requests."""
    return f"{spec.rate_hz:g}"


def stream_request(spec: StreamSpec, lease_s: float) -> Arguments:
    """Return the arguments of a stream request; a lease of 0 real seconds ends the stream."""
    return spec.encoding, rate_text(spec), round(lease_s * 1000)


def parse_stream_request(arguments: tuple[Any, ...]) -> tuple[StreamSpec, float]:
    """Return the spec and the lease, in seconds, of a stream request.

    Raises ProtocolError if the arguments are malformed, and ArgumentError if there is no such rate or encoding.
    """
    if tuple(map(type, arguments)) != (str, str, int):
        raise ProtocolError(f"stream does not take the arguments {arguments!r}, but encoding, rate and lease")
    encoding, rate, lease_ms = arguments
    try:
        spec = StreamSpec(float(rate), encoding)
    except ValueError as error:
        if isinstance(error, EALError):
            raise
        raise ProtocolError(f"stream: the rate {rate!r} is no number") from error
    return canonical(spec), min(max(lease_ms, 0), _MAX_LEASE_MS) / 1000
