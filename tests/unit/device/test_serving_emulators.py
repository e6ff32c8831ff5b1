"""Emulators as programs let bytes go at the pace of their line."""

from __future__ import annotations

import pytest

from eal_actors.device.serving_emulators import LinePace, PacedEmulator


def test_26_bytes_take_4_and_a_half_milliseconds_at_57600_baud() -> None:
    pace = LinePace(57600)
    assert pace.take(5.0) == b""
    pace.put(bytes(range(26)), 10.0)
    assert pace.take(10.0) == b""
    assert pace.take(10.0 + 13.5 / 5760) == bytes(range(13))
    assert pace.take(10.0 + 25.9 / 5760) == bytes(range(13, 25))
    assert pace.take(10.0 + 26.0 / 5760) == bytes([25])


def test_bytes_that_follow_at_once_wait_for_those_before_them() -> None:
    pace = LinePace(10)  # a byte a second
    pace.put(b"ab", 0.0)
    pace.put(b"c", 1.5)
    assert [pace.take(at_s) for at_s in (1.0, 2.0, 2.9, 3.0)] == [b"a", b"b", b"", b"c"]
    pace.put(b"d", 100.0)
    assert [pace.take(at_s) for at_s in (100.9, 101.0)] == [b"", b"d"]


def test_without_a_pace_all_is_there_at_once() -> None:
    pace = LinePace(None)
    pace.put(b"abc", 0.0)
    assert pace.take(0.0) == b"abc"


@pytest.mark.parametrize(("baud_rate", "after_s"), [(None, 0.0), (10, 2.0)])
def test_question_and_answer_both_take_their_time(baud_rate: int | None, after_s: float) -> None:
    class Echo:
        def feed(self, data: bytes, now_s: float) -> bytes:
            return data

    serving = PacedEmulator(Echo(), baud_rate)
    said = serving.feed(b"a", 0.0)
    for tick in range(1, 30):
        if said:
            break
        said = serving.feed(b"", tick / 10)
        assert not said or tick / 10 == pytest.approx(after_s)
    assert said == b"a"
