"""The EvBot III's wire protocol: binary frames, bytes in, bytes out. The README has its tables.

A frame is `00`, a body without zeros, `00`. The body is the COBS form of

    E3, kind (1 request, 2 reply), verb, code (0 in a request), tag (2 bytes), lease (2 bytes; 0 in a reply),
    numbers (4 bytes each, signed), CRC-32 of all before (4 bytes)

with the most significant byte first. A datagram holds one frame; in a stream they follow each other. A frame in any
other form is ignored: its sender gets no reply and sends it again.
"""

from __future__ import annotations

import struct
import zlib
from typing import Final

from ..evbot2.codec import Codec
from ..evbot2.messages import ARGUMENTS, MAX_NUMBERS, BaseReply, BaseRequest, Code, InvalidRequest, Verb

MODEL: Final = 3
MAGIC: Final = 0xE3
REQUEST, REPLY = 1, 2

_HEAD: Final = struct.Struct(">BBBBHH")
_CRC: Final = struct.Struct(">I")
_NUMBER_BYTES: Final = 4
_LONGEST_RUN: Final = 254
MAX_BODY_BYTES: Final = _HEAD.size + MAX_NUMBERS * _NUMBER_BYTES + _CRC.size + 1
"""Of a body without zeros: COBS adds one byte to so few."""

_LONGEST_PARTIAL: Final = MAX_BODY_BYTES + 1  # one byte more than allowed, so that an overlong body stays overlong

_VERBS: Final = {int(verb): verb for verb in Verb}
_CODES: Final = {int(code): code for code in Code}


def stuffed(data: bytes) -> bytes:
    """Return data without its zeros (Consistent Overhead Byte Stuffing): each becomes the distance to the next."""
    out = bytearray()
    for run in data.split(b"\0"):
        rest = run
        while len(rest) >= _LONGEST_RUN:
            out += bytes([_LONGEST_RUN + 1]) + rest[:_LONGEST_RUN]
            rest = rest[_LONGEST_RUN:]
        out += bytes([len(rest) + 1]) + rest
    return bytes(out)


def unstuffed(data: bytes) -> bytes | None:
    """Return the data with its zeros; None if it is damaged."""
    out, at = bytearray(), 0
    while at < len(data):
        step = data[at]
        run = data[at + 1 : at + step]
        if step == 0 or 0 in run or len(run) != step - 1:
            return None
        out += run
        at += step
        if step <= _LONGEST_RUN and at < len(data):
            out.append(0)
    return bytes(out)


def _framed(kind: int, verb: int, code: int, tag: int, lease: int, numbers: tuple[int, ...]) -> bytes:
    data = _HEAD.pack(MAGIC, kind, verb, code, tag, lease) + struct.pack(f">{len(numbers)}i", *numbers)
    return b"\0" + stuffed(data + _CRC.pack(zlib.crc32(data))) + b"\0"


def encode_request(request: BaseRequest) -> bytes:
    """Return a request as a frame."""
    return _framed(REQUEST, request.verb, 0, request.tag, request.lease, request.numbers)


def encode_reply(reply: BaseReply) -> bytes:
    """Return a reply as a frame."""
    return _framed(REPLY, reply.verb, reply.code, reply.tag, 0, reply.numbers)


def _unframed(body: bytes, kind: int) -> tuple[int, int, int, int, tuple[int, ...]] | None:
    """Return verb, code, tag, lease and numbers of a frame's body; None if it is damaged or of another kind."""
    if len(body) > MAX_BODY_BYTES:
        return None
    data = unstuffed(body)
    if data is None or len(data) < _HEAD.size + _CRC.size or (len(data) - _HEAD.size - _CRC.size) % _NUMBER_BYTES:
        return None
    content, crc = data[: -_CRC.size], data[-_CRC.size :]
    magic, found, verb, code, tag, lease = _HEAD.unpack_from(content)
    if crc != _CRC.pack(zlib.crc32(content)) or (magic, found) != (MAGIC, kind):
        return None
    count = (len(content) - _HEAD.size) // _NUMBER_BYTES
    return verb, code, tag, lease, struct.unpack_from(f">{count}i", content, _HEAD.size)


def parse_request(body: bytes) -> BaseRequest | InvalidRequest | None:
    """Return the request in a frame's body; None if it is invalid."""
    if (found := _unframed(body, REQUEST)) is None:
        return None
    number, _, tag, lease, numbers = found
    verb = _VERBS.get(number, Verb.NONE)
    if verb is Verb.NONE:
        return InvalidRequest(tag, Code.VERB)
    if len(numbers) != ARGUMENTS[verb]:
        return InvalidRequest(tag, Code.ARGS)
    return BaseRequest(verb, tag, lease, numbers)


def parse_reply(body: bytes) -> BaseReply | None:
    """Return the reply in a frame's body; None if it is invalid."""
    if (found := _unframed(body, REPLY)) is None:
        return None
    verb, code, tag, _, numbers = found
    if verb not in _VERBS or code not in _CODES:
        return None
    return BaseReply(_VERBS[verb], tag, _CODES[code], numbers)


def base_codec() -> Codec[BaseRequest | InvalidRequest, BaseReply]:
    """Return the codec of a base."""
    return Codec(encode_reply, parse_request, b"\0", _LONGEST_PARTIAL, skip_empty=True)


def host_codec() -> Codec[BaseReply, BaseRequest]:
    """Return the codec of a driver."""
    return Codec(encode_request, parse_reply, b"\0", _LONGEST_PARTIAL, skip_empty=True)
