r"""The EvBot II's serial protocol: lines of text, bytes in, bytes out. The README holds its tables.

    request  $<tag> <lease> <verb> <numbers>*<crc>\n
    reply    $<tag> <verb> <code> <numbers>*<crc>\n

The CRC stands for what is between `$` and `*`: four capital hex digits of CRC-16/XMODEM. A line that is not exactly
so is not there: whoever waits for an answer to it asks again.
"""

from __future__ import annotations

import binascii
import re
from collections.abc import Callable
from typing import Final, Generic, TypeVar

from .messages import ARGUMENTS, MAX_NUMBER, MAX_NUMBERS, TAGS, Code, Nonsense, Reply, Request, Verb

BAUD_RATE: Final = 115200
MODEL: Final = 2
MAX_LINE_BYTES: Final = 160
"""The longest line, with `$` and the line's end."""

_NUMBER: Final = re.compile(r"-?[0-9]{1,10}")
_CRC_BYTES: Final = 4

_T = TypeVar("_T")


def framed(body: str) -> bytes:
    """Return a body as a line, with its CRC."""
    data = body.encode("ascii")
    return b"$%b*%04X\n" % (data, binascii.crc_hqx(data, 0))


def unframed(line: bytes) -> str | None:
    """Return the body of a line without its end; None if it is damaged."""
    if len(line) < 2 + _CRC_BYTES or not line.isascii() or line[:1] != b"$" or line[-1 - _CRC_BYTES] != ord("*"):
        return None
    body, crc = line[1 : -1 - _CRC_BYTES], line[-_CRC_BYTES:]
    return body.decode("ascii") if crc == b"%04X" % binascii.crc_hqx(body, 0) else None


def encode_request(request: Request) -> bytes:
    """Return a request as a line."""
    return framed(" ".join(map(str, (request.tag, request.lease, request.verb.name, *request.numbers))))


def encode_reply(reply: Reply) -> bytes:
    """Return a reply as a line."""
    return framed(" ".join(map(str, (reply.tag, reply.verb.name, reply.code.name, *reply.numbers))))


def parse_request(body: str) -> Request | Nonsense | None:
    """Return the request in a body; None if it is none."""
    tag, lease, word, *words = _padded(body, 3)
    heads, numbers = _numbers([tag, lease], TAGS - 1), _numbers(words, MAX_NUMBER)
    if heads is None or min(heads) < 0:
        return None
    verb = Verb.__members__.get(word, Verb.NONE)
    if verb is Verb.NONE:
        return Nonsense(heads[0], Code.VERB)
    if numbers is None or len(numbers) != ARGUMENTS[verb]:
        return Nonsense(heads[0], Code.ARGS)
    return Request(verb, heads[0], heads[1], numbers)


def parse_reply(body: str) -> Reply | None:
    """Return the reply in a body; None if it is none."""
    tag, verb, code, *words = _padded(body, 3)
    heads, numbers = _numbers([tag], TAGS - 1), _numbers(words, MAX_NUMBER)
    known = verb in Verb.__members__ and code in Code.__members__
    if heads is None or heads[0] < 0 or numbers is None or not known:
        return None
    return Reply(Verb[verb], heads[0], Code[code], numbers)


class _Lines(Generic[_T]):
    """Cuts what arrives, in pieces of any size, into lines; what is not a whole line is passed over.

    Attributes:
        damaged: how many lines were passed over.
    """

    def __init__(self, parse: Callable[[str], _T | None]) -> None:
        self._parse = parse
        self._begun = bytearray()
        self.damaged = 0

    def feed(self, data: bytes) -> list[_T]:
        """Take bytes and return what has become whole by them."""
        self._begun += data
        *lines, rest = self._begun.split(b"\n")
        self._begun = rest[-MAX_LINE_BYTES:]
        found = [parsed for line in lines if (parsed := self._parsed(bytes(line))) is not None]
        self.damaged += len(lines) - len(found)
        return found

    def reset(self) -> None:
        """Forget what has begun to arrive."""
        self._begun.clear()

    def _parsed(self, line: bytes) -> _T | None:
        begin = line.rfind(b"$")  # what stands before it is the rest of a line whose end was lost
        body = unframed(line[begin:]) if begin >= 0 and len(line) - begin < MAX_LINE_BYTES else None
        return self._parse(body) if body is not None else None


class BaseCodec(_Lines[Request | Nonsense]):
    """The base's side: requests in, replies out."""

    def __init__(self) -> None:
        super().__init__(parse_request)

    def encode(self, reply: Reply) -> bytes:
        """Return a reply as bytes."""
        return encode_reply(reply)


class HostCodec(_Lines[Reply]):
    """The host's side: replies in, requests out."""

    def __init__(self) -> None:
        super().__init__(parse_reply)

    def encode(self, request: Request) -> bytes:
        """Return a request as bytes."""
        return encode_request(request)


def _padded(body: str, count: int) -> list[str]:
    words = body.split(" ")
    return words + [""] * (count - len(words))


def _numbers(words: list[str], most: int) -> tuple[int, ...] | None:
    """Return the whole numbers that words are; None if one is none, or too large."""
    if len(words) > MAX_NUMBERS or not all(_NUMBER.fullmatch(word) for word in words):
        return None
    numbers = tuple(map(int, words))
    return numbers if all(abs(number) <= most for number in numbers) else None
