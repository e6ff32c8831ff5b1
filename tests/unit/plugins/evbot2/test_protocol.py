"""plugins/evbot2/protocol.py: lines as the README's tables have them; whatever arrives, nothing crashes."""

from __future__ import annotations

import binascii

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.evbot2.messages import BaseReply, BaseRequest, Code, InvalidRequest, Verb, is_newer
from plugins.evbot2.protocol import MAX_LINE_BYTES, base_codec, host_codec
from tests.unit.plugins.evbot2.streams import TAGS, assert_survives, damaged, replies, requests

REQUESTS = [
    (b"$1 0 HELLO 1 500 77*69A7\n", BaseRequest(Verb.HELLO, 1, 0, (1, 500, 77))),
    (b"$1 42 STAT*181F\n", BaseRequest(Verb.STAT, 1, 42)),
    (b"$1 42 MOVE 500000 500000 250000*0E33\n", BaseRequest(Verb.MOVE, 1, 42, (500000, 500000, 250000))),
    (b"$2 42 VEL -100000 100000 500*F276\n", BaseRequest(Verb.VEL, 2, 42, (-100000, 100000, 500))),
    (b"$3 42 STOP*BDF3\n", BaseRequest(Verb.STOP, 3, 42)),
]

REPLIES = [
    (
        b"$1 HELLO OK 2 1 41 42 500 400000 0 0*18C2\n",
        BaseReply(Verb.HELLO, 1, Code.OK, (2, 1, 41, 42, 500, 400000, 0, 0)),
    ),
    (b"$1 STAT OK 1500 0 0 0 0 0*F3B9\n", BaseReply(Verb.STAT, 1, Code.OK, (1500, 0, 0, 0, 0, 0))),
    (b"$3 STOP OK 4010 2 3 812 -790 0*63D2\n", BaseReply(Verb.STOP, 3, Code.OK, (4010, 2, 3, 812, -790, 0))),
    (b"$9 STAT LEASE*A20C\n", BaseReply(Verb.STAT, 9, Code.LEASE)),
    (b"$4 MOVE RANGE*DA11\n", BaseReply(Verb.MOVE, 4, Code.RANGE)),
    (b"$4 NONE ARGS*8C3B\n", BaseReply(Verb.NONE, 4, Code.ARGS)),
    (b"$5 NONE VERB*269D\n", BaseReply(Verb.NONE, 5, Code.VERB)),
]

NONSENSE = [
    (b"$4 42 MOVE 1 2*C7EB\n", InvalidRequest(4, Code.ARGS)),
    (b"$5 42 JUMP*5EF9\n", InvalidRequest(5, Code.VERB)),
]


@pytest.mark.parametrize(("line", "request_"), REQUESTS)
def test_a_request_is_this_line(line: bytes, request_: BaseRequest) -> None:
    assert host_codec().encode(request_) == line
    assert base_codec().feed(line) == [request_]


@pytest.mark.parametrize(("line", "reply"), REPLIES)
def test_a_reply_is_this_line(line: bytes, reply: BaseReply) -> None:
    assert base_codec().encode(reply) == line
    assert host_codec().feed(line) == [reply]


@pytest.mark.parametrize(("line", "nonsense"), NONSENSE)
def test_a_whole_line_without_sense_gets_a_code(line: bytes, nonsense: InvalidRequest) -> None:
    assert base_codec().feed(line) == [nonsense]


def closed(body: str) -> bytes:
    data = body.encode()
    return b"$%b*%04X\n" % (data, binascii.crc_hqx(data, 0))


@pytest.mark.parametrize(
    "line",
    [
        b"$1 42 STAT*181E\n",  # another CRC
        b"$1 42 STAT*181f\n",  # small letters
        b"1 42 STAT*181F\n",
        b"$1 42 STAT181F\n",
        b"$1 42 STAT*181F \n",
        b"$*0000\n",
        b"$\n",
        b"*0000\n",
        b"\n",
        closed("65536 42 STAT"),
        closed("-1 42 STAT"),
        closed("1 -2 STAT"),
        closed("x 42 STAT"),
        closed("1 STAT"),
        closed("+1 42 STAT"),
        closed("1_0 42 STAT"),
    ],
)
def test_what_is_no_request_is_passed_over(line: bytes) -> None:
    codec = base_codec()
    assert codec.feed(line) == []
    assert codec.feed(REQUESTS[1][0]) == [REQUESTS[1][1]]


@pytest.mark.parametrize(
    "numbers", ["1 2", "1 2 3 4", "1 2 x", "1 2 2147483648", "1 2 99999999999999999999", "1  2", "1 2 3 "]
)
def test_wrong_numbers_are_refused_by_a_code(numbers: str) -> None:
    assert base_codec().feed(closed(f"7 42 MOVE {numbers}")) == [InvalidRequest(7, Code.ARGS)]


@pytest.mark.parametrize(
    "body", ["1 STAT", "1 STAT OKAY", "1 JUMP OK", "1 STAT OK 1.5", "65536 STAT OK", "-3 STAT OK", ""]
)
def test_what_is_no_reply_is_passed_over(body: str) -> None:
    assert host_codec().feed(closed(body) + REPLIES[0][0]) == [REPLIES[0][1]]


LEAST = -(2**31) + 1


@given(st.binary(max_size=400), st.binary(max_size=400))
def test_any_bytes_do_no_harm_and_the_next_line_is_understood(noise: bytes, more: bytes) -> None:
    for codec, line, wanted in ((base_codec(), *REQUESTS[2]), (host_codec(), *REPLIES[2])):
        codec.feed(noise)
        codec.feed(more)
        assert codec.feed(b"\n" + line)[-1:] == [wanted]


@given(st.lists(requests(LEAST), max_size=5), st.data())
def test_requests_survive_the_wire_however_it_cuts_them(sent: list[BaseRequest], data: st.DataObject) -> None:
    assert_survives(sent, host_codec(), base_codec(), data)


@given(st.lists(replies(8, LEAST), max_size=5), st.data())
def test_replies_survive_the_wire_however_it_cuts_them(sent: list[BaseReply], data: st.DataObject) -> None:
    assert_survives(sent, base_codec(), host_codec(), data)


@given(requests(LEAST), st.data())
def test_a_changed_byte_never_makes_another_request(request_: BaseRequest, data: st.DataObject) -> None:
    received = damaged(host_codec().encode(request_), data) + b"\n"
    assert [got for got in base_codec().feed(received) if got != request_] == []


@given(requests(LEAST))
def test_a_line_whose_end_was_lost_takes_no_other_with_it(request_: BaseRequest) -> None:
    begun = host_codec().encode(BaseRequest(Verb.STOP, 3, 42))[:-3]
    assert base_codec().feed(begun + host_codec().encode(request_)) == [request_]


def test_the_longest_line_fits_and_a_longer_one_is_passed_over() -> None:
    longest = BaseReply(Verb.HELLO, 65535, Code.VERSION, (-(2**31) + 1,) * 10)
    line = base_codec().encode(longest)
    assert len(line) <= MAX_LINE_BYTES
    assert host_codec().feed(line) == [longest]
    codec = host_codec()
    assert codec.feed(b"$" + b"1" * 100_000) == []
    assert codec.feed(b"\n" + line) == [longest]


@given(TAGS, st.integers(1, 32767))
def test_tags_are_compared_round_the_circle(tag: int, ahead: int) -> None:
    assert is_newer((tag + ahead) % 65536, tag)
    assert not is_newer(tag, (tag + ahead) % 65536)
    assert not is_newer(tag, tag)
