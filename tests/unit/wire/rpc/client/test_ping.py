"""The interpretation of ping answers."""

from __future__ import annotations

from typing import Any

import pytest

from eal_actors.actors.robot_view import Ping, RobotState
from eal_actors.kernel.errors import ProtocolError, UnavailableError
from eal_actors.wire.format.messages import Answer, RobotTime
from eal_actors.wire.rpc.client.clock_offset import ClockTracker

ANSWER: dict[str, Any] = {
    "release": "1.2.3",
    "state": "ready",
    "resources": 4,
    "stopped": None,
    "holders": {"Base": "0123456789abcdef"},
}


def take(tracker: ClockTracker, answer: Answer, sent_s: float, answered_s: float, era: str | None = "a") -> Ping:
    return tracker.read_ping(answer, None if era is None else RobotTime(era, 0.0), sent_s, answered_s)


def answer(received_s: float, replied_s: float, **fields: Any) -> dict[str, Any]:
    return {**ANSWER, "received_s": received_s, "replied_s": replied_s, **fields}


def test_the_answer_is_handed_on_with_what_the_clocks_tell() -> None:
    ping = take(ClockTracker(), answer(100.5, 100.75, stopped="a dog"), 0.0, 1.25)
    assert (ping.state, ping.release, ping.resources, ping.stopped) == (RobotState.READY, "1.2.3", 4, "a dog")
    assert ping.holders == {"Base": "0123456789abcdef"}
    assert ping.round_trip_s == 1.0
    assert ping.offset_s == 100.0
    assert 0.5 <= ping.offset_error_s < 0.51


def test_the_best_ping_so_far_tells_the_offset_and_each_its_own_round_trip() -> None:
    tracker = ClockTracker()
    take(tracker, answer(100.0625, 100.0625), 0.0, 0.125)
    slow = take(tracker, answer(101.75, 101.75), 1.0, 2.0)
    assert slow.round_trip_s == 1.0
    assert slow.offset_s == 100.0
    assert slow.offset_error_s < 0.07


def test_a_robot_that_was_restarted_has_another_clock() -> None:
    tracker = ClockTracker()
    take(tracker, answer(100.0, 100.0), 0.0, 0.0)
    assert take(tracker, answer(7.0, 7.0), 1.0, 3.0, era="b").offset_s == 5.0


def test_errors_go_to_who_waits() -> None:
    with pytest.raises(UnavailableError, match="no"):
        take(ClockTracker(), UnavailableError("no"), 0.0, 1.0)


@pytest.mark.parametrize(
    "nonsense",
    [
        1,
        {},
        {"received_s": 0.5, "replied_s": 0.5},
        answer(0.5, 0.25),
        answer(0.5, float("nan")),
        {**answer(0.5, 0.5), "received_s": "soon"},
        answer(0.5, 0.5, state="happy"),
        answer(0.5, 0.5, resources="many"),
        answer(0.5, 0.5, holders=3),
        answer(0.5, 0.5, mailboxes={"Base": [1]}),
        answer(0.5, 9.5),
    ],
)
def test_nonsense_is_an_error_of_the_protocol(nonsense: Answer) -> None:
    with pytest.raises(ProtocolError):
        take(ClockTracker(), nonsense, 0.0, 1.0)


def test_an_answer_without_the_robot_s_clock_is_nonsense() -> None:
    with pytest.raises(ProtocolError):
        take(ClockTracker(), answer(0.5, 0.5), 0.0, 1.0, era=None)
