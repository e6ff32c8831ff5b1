"""plugins/roomba: which bytes are a reply, and to which request they belong."""

from __future__ import annotations

import pytest

from plugins.roomba.replies import ReplyReader, ReplyState

SIZE = 4


def reader(delay_s: float | None = None) -> ReplyReader:
    """Return a reader, which has measured a delay."""
    replies = ReplyReader(SIZE, 0.2, 0.05, 0.03)
    if delay_s is not None:
        replies.ask(0.0)
        replies.feed(bytes(SIZE), delay_s)
        replies.take()
    return replies


def test_a_whole_reply_is_taken_after_a_silence() -> None:
    replies = reader()
    replies.ask(1.0)
    replies.feed(b"ab", 1.01)
    assert replies.state(1.02) is ReplyState.AWAITED
    replies.feed(b"cd", 1.03)
    assert replies.state(1.03) is ReplyState.AWAITED
    assert replies.state(1.034) is ReplyState.WHOLE
    assert [(reply.data, reply.asked_s) for reply in replies.take()] == [(b"abcd", 1.0)]
    assert replies.delay_s == pytest.approx(0.03)


@pytest.mark.parametrize("data", [b"abc", b"abcde"])
def test_a_byte_less_or_more_spoils_it(data: bytes) -> None:
    replies = reader()
    replies.ask(1.0)
    replies.feed(data, 1.01)
    assert replies.state(1.05) is ReplyState.DAMAGED
    replies.give_up(ReplyState.DAMAGED)
    replies.ask(1.1)
    replies.feed(b"wxyz", 1.11)
    assert [reply.data for reply in replies.take()] == [b"wxyz"]


def test_the_time_limit_follows_the_delay() -> None:
    fast, slow = reader(0.01), reader(0.1)
    for replies in (fast, slow):
        replies.ask(1.0)
    assert fast.state(1.06) is ReplyState.LOST
    assert slow.state(1.3) is ReplyState.AWAITED
    assert slow.state(1.41) is ReplyState.LOST


def test_after_a_lost_request_a_reply_in_the_usual_time_is_that_to_the_latest() -> None:
    replies = reader(0.01)
    replies.ask(1.0)
    replies.give_up(ReplyState.LOST)
    replies.ask(1.1)
    replies.feed(bytes(SIZE), 1.11)
    (reply,) = replies.take()
    assert reply.asked_s == 1.1
    assert reply.jitter_s == pytest.approx(0.0, abs=1e-6)
    assert not replies.awaits_others(1.11)


def test_when_the_line_becomes_slow_each_reply_still_belongs_to_its_request() -> None:
    replies = reader(0.01)
    asked = (1.0, 1.05, 1.1)
    for time_s in asked:
        replies.ask(time_s)
    taken = []
    for time_s in asked:
        replies.feed(bytes(SIZE), time_s + 0.5)
        taken += [reply.asked_s for reply in replies.take()]
        assert replies.awaits_others(time_s + 0.5) is (time_s != asked[-1])
    assert taken == list(asked)
