"""Events of input devices, as bytes of `struct input_event` (Source: linux/input.h), and the wish of a hand."""

from __future__ import annotations

import struct

from hypothesis import given
from hypothesis import strategies as st

from eal_actors.operate.hands.sticks import AxisRange, EventReader, Sticks, curved

EV_SYN, EV_KEY, EV_ABS = 0, 1, 3
BTN_TR, ABS_X, ABS_Y, KEY_W, KEY_A = 0x137, 0, 1, 17, 30


def event(kind: int, code: int, value: int) -> bytes:
    return struct.pack("@llHHi", 1, 2, kind, code, value)


def hand(*events: bytes, ranges: dict[int, AxisRange] | None = None) -> Sticks:
    sticks, reader = Sticks(ranges, expo=0.0), EventReader()
    for one in reader.feed(b"".join(events)):
        sticks.feed(one)
    return sticks


def test_a_stick_counts_only_with_a_shoulder_button() -> None:
    full = event(EV_ABS, ABS_Y, -32768)
    assert hand(full).wish() == (0.0, 0.0)
    assert hand(full, event(EV_KEY, BTN_TR, 1)).wish()[0] > 0.99
    assert hand(full, event(EV_KEY, BTN_TR, 1), event(EV_KEY, BTN_TR, 0)).wish() == (0.0, 0.0)


def test_the_ranges_of_the_device_count() -> None:
    sticks = hand(event(EV_KEY, BTN_TR, 1), event(EV_ABS, ABS_X, 0), ranges={ABS_X: AxisRange(0, 255)})
    assert sticks.wish() == (0.0, 1.0)


def test_keys_drive_while_they_are_held() -> None:
    sticks = hand(event(EV_KEY, KEY_W, 1), event(EV_KEY, KEY_A, 1), event(EV_KEY, KEY_W, 2))
    assert (sticks.wish(), sticks.press) == ((1.0, 1.0), 1)


def test_after_lost_events_nothing_is_held_until_it_is_pressed_again() -> None:
    sticks = hand(event(EV_KEY, BTN_TR, 1), event(EV_ABS, ABS_Y, -32768), event(EV_SYN, 3, 0))
    assert not sticks.is_held
    for value, held in ((1, False), (0, False), (1, True)):
        for one in EventReader().feed(event(EV_KEY, BTN_TR, value)):
            sticks.feed(one)
        assert sticks.is_held is held
    assert (sticks.press, sticks.wish()) == (2, (0.0, 0.0))


def test_the_curve_is_fine_near_the_middle_and_full_at_the_end() -> None:
    assert curved(0.1, 0.6) == 0
    assert 0 < curved(0.5, 1.0) < curved(0.5, 0.6) < curved(0.5, 0.0) < 0.5
    assert curved(-1.0, 0.6) == -1.0


@given(st.binary(max_size=200), st.integers(1, 60))
def test_any_bytes_give_wishes_within_the_range(data: bytes, size: int) -> None:
    sticks, reader = Sticks(), EventReader()
    for start in range(0, len(data), size):
        for one in reader.feed(data[start : start + size]):
            sticks.feed(one)
    assert all(-1 <= part <= 1 for part in sticks.wish())
    assert sticks.is_held or sticks.wish() == (0.0, 0.0)
