r"""The EvBot II's serial protocol: lines of text, bytes in, bytes out. The README has its tables.

    request  $<tag> <lease> <verb> <numbers>*<crc>\n
    reply    $<tag> <verb> <code> <numbers>*<crc>\n

The CRC covers the text between `$` and `*`: four capital hex digits of CRC-16/XMODEM. A line in any other form is
ignored: its sender gets no reply and sends it again.
"""

from __future__ import annotations

import binascii
import re
from typing import Final

from .codec import Codec
from .messages import ARGUMENTS, MAX_NUMBER, MAX_NUMBERS, TAGS, BaseReply, BaseRequest, Code, InvalidRequest, Verb

BAUD_RATE: Final = 115200
MODEL: Final = 2
MAX_LINE_BYTES: Final = 160
"""The longest line, including `$` and the newline."""

_NUMBER: Final = re.compile(r"-?[0-9]{1,10}")
_CRC_BYTES: Final = 4


def framed(body: str) -> bytes:
    """Return a body as a line, with its CRC."""
    data = body.encode("ascii")
    return b"$%b*%04X\n" % (data, binascii.crc_hqx(data, 0))


def unframed(line: bytes) -> str | None:
    """Return the body of a line without its newline; None if it is damaged."""
    if len(line) < 2 + _CRC_BYTES or not line.isascii() or line[:1] != b"$" or line[-1 - _CRC_BYTES] != ord("*"):
        return None
    body, crc = line[1 : -1 - _CRC_BYTES], line[-_CRC_BYTES:]
    return body.decode("ascii") if crc == b"%04X" % binascii.crc_hqx(body, 0) else None


def encode_request(request: BaseRequest) -> bytes:
    """Return a request as a line."""
    return framed(" ".join(map(str, (request.tag, request.lease, request.verb.name, *request.numbers))))


def encode_reply(reply: BaseReply) -> bytes:
    """Return a reply as a line."""
    return framed(" ".join(map(str, (reply.tag, reply.verb.name, reply.code.name, *reply.numbers))))


def parse_request(line: bytes) -> BaseRequest | InvalidRequest | None:
    """Return the request in a line; None if it is invalid."""
    if (body := _body_of(line)) is None:
        return None
    tag, lease, word, *words = _pad(body, 3)
    heads, numbers = _parse_numbers([tag, lease], TAGS - 1), _parse_numbers(words, MAX_NUMBER)
    if heads is None or min(heads) < 0:
        return None
    verb = Verb.__members__.get(word, Verb.NONE)
    if verb is Verb.NONE:
        return InvalidRequest(heads[0], Code.VERB)
    if numbers is None or len(numbers) != ARGUMENTS[verb]:
        return InvalidRequest(heads[0], Code.ARGS)
    return BaseRequest(verb, heads[0], heads[1], numbers)


def parse_reply(line: bytes) -> BaseReply | None:
    """Return the reply in a line; None if it is invalid."""
    if (body := _body_of(line)) is None:
        return None
    tag, verb, code, *words = _pad(body, 3)
    heads, numbers = _parse_numbers([tag], TAGS - 1), _parse_numbers(words, MAX_NUMBER)
    known = verb in Verb.__members__ and code in Code.__members__
    if heads is None or heads[0] < 0 or numbers is None or not known:
        return None
    return BaseReply(Verb[verb], heads[0], Code[code], numbers)


def base_codec() -> Codec[BaseRequest | InvalidRequest, BaseReply]:
    """Return the codec of a base."""
    return Codec(encode_reply, parse_request, b"\n", MAX_LINE_BYTES, skip_empty=False)


def host_codec() -> Codec[BaseReply, BaseRequest]:
    """Return the codec of a driver."""
    return Codec(encode_request, parse_reply, b"\n", MAX_LINE_BYTES, skip_empty=False)


def _body_of(line: bytes) -> str | None:
    """Return the body of a line, without the rest of a line before it whose end was lost; None if it is damaged."""
    begin = line.rfind(b"$")
    return unframed(line[begin:]) if begin >= 0 and len(line) - begin < MAX_LINE_BYTES else None


def _pad(body: str, count: int) -> list[str]:
    words = body.split(" ")
    return words + [""] * (count - len(words))


def _parse_numbers(words: list[str], most: int) -> tuple[int, ...] | None:
    """Return words as whole numbers; None if one is invalid or too large."""
    if len(words) > MAX_NUMBERS or not all(_NUMBER.fullmatch(word) for word in words):
        return None
    numbers = tuple(map(int, words))
    return numbers if all(abs(number) <= most for number in numbers) else None
