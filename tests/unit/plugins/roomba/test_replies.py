"""plugins/roomba: which bytes are a reply, and to which request they belong."""

from __future__ import annotations

import pytest

from plugins.roomba.groups import Contacts, Controls, is_group
from plugins.roomba.replies import ReplyReader, ReplyState

CONTACTS, CONTROLS = 1, 2
REPLY = Controls(distance_mm=12, angle_mm=-3).encode()
TOUCH = Contacts(bump_left=True).encode()


def reader(delay_s: float | None = None) -> ReplyReader:
    """Return a reader, which has measured a delay."""
    replies = ReplyReader(0.2, 0.05, 0.03)
    if delay_s is not None:
        replies.ask(CONTROLS, 0.0)
        replies.feed(REPLY, delay_s)
        replies.take()
    return replies


def test_a_whole_reply_is_taken_after_a_silence() -> None:
    replies = reader()
    replies.ask(CONTROLS, 1.0)
    replies.feed(REPLY[:2], 1.01)
    assert replies.state(1.02) is ReplyState.AWAITED
    replies.feed(REPLY[2:], 1.03)
    assert replies.state(1.03) is ReplyState.AWAITED
    assert replies.state(1.034) is ReplyState.WHOLE
    assert [(reply.data, reply.asked_s) for reply in replies.take()] == [(REPLY, 1.0)]
    assert replies.delay_s == pytest.approx(0.03)


@pytest.mark.parametrize("data", [REPLY[:-1], REPLY + b"x"])
def test_a_byte_less_or_more_spoils_it(data: bytes) -> None:
    replies = reader()
    replies.ask(CONTROLS, 1.0)
    replies.feed(data, 1.01)
    assert replies.state(1.05) is ReplyState.DAMAGED
    replies.give_up(ReplyState.DAMAGED)
    replies.ask(CONTROLS, 1.1)
    replies.feed(REPLY, 1.11)
    assert [reply.data for reply in replies.take()] == [REPLY]


def test_the_time_limit_follows_the_delay() -> None:
    fast, slow = reader(0.01), reader(0.1)
    for replies in (fast, slow):
        replies.ask(CONTROLS, 1.0)
    assert fast.state(1.06) is ReplyState.LOST
    assert slow.state(1.3) is ReplyState.AWAITED
    assert slow.state(1.41) is ReplyState.LOST


def test_after_a_lost_request_a_reply_in_the_usual_time_is_that_to_the_latest() -> None:
    replies = reader(0.01)
    replies.ask(CONTROLS, 1.0)
    replies.give_up(ReplyState.LOST)
    replies.ask(CONTROLS, 1.1)
    replies.feed(REPLY, 1.11)
    (reply,) = replies.take()
    assert reply.asked_s == 1.1
    assert reply.jitter_s == pytest.approx(0.0, abs=1e-6)
    assert not replies.awaits_others(1.11)


def test_when_the_line_becomes_slow_each_reply_still_belongs_to_its_request() -> None:
    replies = reader(0.01)
    asked = (1.0, 1.05, 1.1)
    for time_s in asked:
        replies.ask(CONTROLS, time_s)
    taken = []
    for time_s in asked:
        replies.feed(REPLY, time_s + 0.5)
        taken += [reply.asked_s for reply in replies.take()]
        assert replies.awaits_others(time_s + 0.5) is (time_s != asked[-1])
    assert taken == list(asked)


def test_replies_of_two_groups_are_told_apart_by_their_bytes() -> None:
    replies = reader(0.01)
    for group, time_s in ((CONTACTS, 1.0), (CONTROLS, 1.1), (CONTACTS, 1.2)):
        replies.ask(group, time_s)
    replies.feed(REPLY + TOUCH, 1.25)  # sixteen bytes answer the first two, too, but for their order
    assert replies.state(1.26) is ReplyState.WHOLE
    assert [(reply.group, reply.data, reply.asked_s) for reply in replies.take()] == [
        (CONTROLS, REPLY, 1.1),
        (CONTACTS, TOUCH, 1.2),
    ]


def test_bytes_that_are_no_group_are_no_reply() -> None:
    replies = reader(0.01)
    replies.ask(CONTACTS, 1.0)
    replies.feed(b"\xff" * len(TOUCH), 1.01)
    assert replies.state(1.05) is ReplyState.DAMAGED


@pytest.mark.parametrize(
    ("delay_s", "data"),
    [(None, Contacts().encode() * 8 + REPLY[:-1]), (1.0, REPLY[1:] + Contacts().encode() * 8)],
    ids=["as the oldest", "as the latest"],
)
def test_what_came_after_a_long_pause_is_matched_at_once(
    delay_s: float | None, data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    decoded: list[int] = []

    def counted(group: int, part: bytes) -> bool:
        decoded.append(group)
        return is_group(group, part)

    replies = reader(delay_s)
    monkeypatch.setattr(f"{ReplyReader.__module__}.is_group", counted)
    for number in range(16):
        replies.ask((CONTACTS, CONTROLS)[number % 2], 1.0 + 0.01 * number)
    replies.feed(data, 1.5)  # with very many pairings
    assert replies.state(1.6) is ReplyState.DAMAGED
    assert len(decoded) < 300
