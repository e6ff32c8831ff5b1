"""plugins/evbot3/protocol.py: frames as the README's tables have them; whatever arrives, nothing crashes."""

from __future__ import annotations

import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.evbot2.messages import BaseReply, BaseRequest, Code, InvalidRequest, Verb
from plugins.evbot3.protocol import base_codec, host_codec, stuffed, unstuffed
from tests.unit.plugins.evbot2.streams import assert_survives, damaged, replies, requests

REQUESTS = [
    (
        "00 04 e3 01 01 01 02 01 01 01 01 01 02 01 01 03 01 f4 01 01 06 4d 0c 3c 87 71 00",
        BaseRequest(Verb.HELLO, 1, 0, (1, 500, 77)),
    ),
    ("00 04 e3 01 02 01 02 01 06 2a 59 bb f4 b5 00", BaseRequest(Verb.STAT, 1, 42)),
    ("00 04 e3 01 05 01 02 03 06 2a 47 3a 10 63 00", BaseRequest(Verb.STOP, 3, 42)),
    (
        "00 04 e3 01 07 02 01 01 06 2a ff e8 08 14 08 17 f7 ec 74 9c 9b cb 00",
        BaseRequest(Verb.AIM, 256, 42, (-1570796, 1570796)),
    ),
]
REPLY = ("00 05 e3 02 02 01 02 09 01 05 80 9b 5f f6 00", BaseReply(Verb.STAT, 9, Code.LEASE))


@pytest.mark.parametrize(("frame", "request_"), REQUESTS)
def test_a_request_is_this_frame(frame: str, request_: BaseRequest) -> None:
    assert host_codec().encode(request_).hex(" ") == frame
    assert base_codec().feed(bytes.fromhex(frame)) == [request_]


def test_a_reply_is_this_frame() -> None:
    frame, reply = REPLY
    assert base_codec().encode(reply).hex(" ") == frame
    assert host_codec().feed(bytes.fromhex(frame)) == [reply]


@pytest.mark.parametrize(
    ("data", "without_zeros"),
    [  # Cheshire and Baker, table of examples
        ("00", "01 01"),
        ("00 00", "01 01 01"),
        ("11 22 00 33", "03 11 22 02 33"),
        ("11 22 33 44", "05 11 22 33 44"),
        ("11 00 00 00", "02 11 01 01 01"),
    ],
)
def test_stuffing(data: str, without_zeros: str) -> None:
    assert stuffed(bytes.fromhex(data)).hex(" ") == without_zeros
    assert unstuffed(bytes.fromhex(without_zeros)) == bytes.fromhex(data)


@given(st.binary(max_size=700))
def test_stuffing_leaves_no_zero_and_comes_back(data: bytes) -> None:
    assert 0 not in stuffed(data)
    assert unstuffed(stuffed(data)) == data


def made(kind: int, verb: int, code: int, tag: int, lease: int, *numbers: int, magic: int = 0xE3) -> bytes:
    data = struct.pack(f">BBBBHH{len(numbers)}i", magic, kind, verb, code, tag, lease, *numbers)
    return b"\0" + stuffed(data + struct.pack(">I", zlib.crc32(data))) + b"\0"


@pytest.mark.parametrize(
    ("frame", "found"),
    [
        (made(1, 99, 0, 7, 42), [InvalidRequest(7, Code.VERB)]),
        (made(1, 0, 0, 7, 42), [InvalidRequest(7, Code.VERB)]),
        (made(1, 3, 0, 7, 42, 1, 2), [InvalidRequest(7, Code.ARGS)]),
        (made(1, 2, 0, 7, 42, 1), [InvalidRequest(7, Code.ARGS)]),
        (made(2, 2, 0, 7, 42), []),  # a reply is no request
        (made(1, 2, 0, 7, 42, magic=0xE2), []),
        (b"\0" + stuffed(b"\xe3\x01") + b"\0", []),
    ],
)
def test_requests_without_sense(frame: bytes, found: list[InvalidRequest]) -> None:
    assert base_codec().feed(frame) == found


@pytest.mark.parametrize("frame", [made(2, 99, 0, 7, 0), made(2, 2, 99, 7, 0), made(1, 2, 0, 7, 0)])
def test_replies_without_sense_are_passed_over(frame: bytes) -> None:
    assert host_codec().feed(frame) == []


@given(st.binary(max_size=400), st.binary(max_size=400))
def test_any_bytes_do_no_harm_and_the_next_frame_is_understood(noise: bytes, more: bytes) -> None:
    base, host = base_codec(), host_codec()
    for codec in (base, host):
        codec.feed(noise)
        codec.feed(more)
    assert base.feed(bytes.fromhex(REQUESTS[1][0]))[-1:] == [REQUESTS[1][1]]
    assert host.feed(bytes.fromhex(REPLY[0]))[-1:] == [REPLY[1]]


@given(st.lists(requests(), max_size=5), st.data())
def test_requests_survive_the_wire_however_it_cuts_them(sent: list[BaseRequest], data: st.DataObject) -> None:
    assert_survives(sent, host_codec(), base_codec(), data)


@given(st.lists(replies(24), max_size=5), st.data())
def test_replies_survive_the_wire_however_it_cuts_them(sent: list[BaseReply], data: st.DataObject) -> None:
    assert_survives(sent, base_codec(), host_codec(), data)


@given(requests(), st.data())
def test_a_changed_byte_never_makes_another_request(request_: BaseRequest, data: st.DataObject) -> None:
    received = damaged(host_codec().encode(request_), data) + b"\0"
    assert [got for got in base_codec().feed(received) if got != request_] == []


def test_bytes_without_an_end_are_not_kept() -> None:
    codec = base_codec()
    for _ in range(100):
        assert codec.feed(b"\1" * 10_000) == []
    assert len(codec._partial) < 1000
    assert codec.feed(bytes.fromhex(REQUESTS[1][0])) == [REQUESTS[1][1]]
