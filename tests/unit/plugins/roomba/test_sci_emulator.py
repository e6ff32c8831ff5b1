"""plugins/roomba: the emulated Roomba does what the document says of the real one."""

from __future__ import annotations

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from plugins.roomba import sci
from plugins.roomba.bodies import ConstantBattery, FreeRoombaBody
from plugins.roomba.groups import Contacts, Controls, PowerGroup
from plugins.roomba.sci import WHEELBASE_M, Mode, SciLights, StatusLed
from plugins.roomba.sci_driver import twist_drive
from plugins.roomba.sci_emulator import SciEmulator

START, CONTROL, SAFE, FULL = b"\x80", b"\x82", b"\x83", b"\x84"


class Bench:
    """An emulator on a table: bytes go in, the time passes when the test says so."""

    def __init__(self, *, mode: Mode = Mode.SAFE, acceleration_m_s2: float = 1e9) -> None:
        self.now_s = 0.0
        self.body = FreeRoombaBody(lambda: self.now_s, WHEELBASE_M, acceleration_m_s2)
        self.roomba = SciEmulator(self.body)
        way = {Mode.OFF: b"", Mode.PASSIVE: START, Mode.SAFE: START + CONTROL, Mode.FULL: START + CONTROL + FULL}
        for byte in way[mode]:
            self.send(byte)
            self.now_s += 0.02

    def send(self, *data: int) -> bytes:
        return self.roomba.feed(bytes(data), self.now_s)

    def distance_and_angle(self) -> tuple[int, int]:
        controls = Controls.decode(self.send(142, 2))
        return controls.distance_mm, controls.angle_mm

    @property
    def speeds_m_s(self) -> tuple[float, float]:
        return self.body.left.target_m_s, self.body.right.target_m_s


@pytest.mark.parametrize(
    ("mode", "op", "after"),
    [
        (Mode.OFF, 128, Mode.PASSIVE),
        (Mode.OFF, 130, Mode.OFF),
        (Mode.PASSIVE, 130, Mode.SAFE),
        (Mode.PASSIVE, 131, Mode.PASSIVE),
        (Mode.PASSIVE, 132, Mode.PASSIVE),
        (Mode.SAFE, 132, Mode.FULL),
        (Mode.SAFE, 130, Mode.SAFE),
        (Mode.SAFE, 128, Mode.PASSIVE),
        (Mode.FULL, 131, Mode.SAFE),
        (Mode.FULL, 128, Mode.PASSIVE),
        *((mode, op, Mode.PASSIVE) for mode in (Mode.SAFE, Mode.FULL) for op in (133, 134, 135, 136)),
    ],
)
def test_modes(mode: Mode, op: int, after: Mode) -> None:
    bench = Bench(mode=mode)
    bench.send(op)
    assert bench.roomba.mode is after


def test_it_hears_nothing_for_20_ms_after_a_change_of_mode() -> None:
    bench = Bench(mode=Mode.OFF)
    bench.send(128)
    bench.now_s = 0.019
    bench.send(130)
    assert (bench.roomba.mode, bench.roomba.violations) == (Mode.PASSIVE, 1)
    bench.now_s = 0.02
    bench.send(130)
    assert (bench.roomba.mode, bench.roomba.violations) == (Mode.SAFE, 1)


def test_it_hears_nothing_for_100_ms_after_a_change_of_the_baud_rate() -> None:
    bench = Bench()
    bench.send(129, 7)
    assert (bench.roomba.baud_rate, bench.roomba.mode) == (19200, Mode.PASSIVE)
    bench.now_s += 0.09
    assert bench.send(142, 0) == b""
    bench.now_s += 0.011
    assert len(bench.send(142, 0)) == 26
    bench.send(129, 12)
    assert (bench.roomba.baud_rate, bench.roomba.violations, bench.roomba.refused) == (19200, 2, 1)


def test_without_a_pause_it_hears_everything() -> None:
    roomba = SciEmulator(FreeRoombaBody(lambda: 0.0, WHEELBASE_M), mode_pause_s=0.0)
    assert len(roomba.feed(START + CONTROL + FULL + bytes([142, 0]), 0.0)) == 26
    assert (roomba.mode, roomba.violations) == (Mode.FULL, 0)


@pytest.mark.parametrize(
    ("data", "left", "right"),
    [
        ([137, 1, 44, 128, 0], 0.3, 0.3),
        ([137, 255, 56, 128, 0], -0.2, -0.2),
        ([137, 0, 100, 255, 255], 0.1, -0.1),
        ([137, 0, 100, 0, 1], -0.1, 0.1),
        ([137, 0, 200, 1, 2], 0.1, 0.3),  # radius 258 mm to the left: the wheels run at 129 and 387 mm
        ([137, 255, 56, 1, 244], -0.1484, -0.2516),
    ],
)
def test_drive(data: list[int], left: float, right: float) -> None:
    bench = Bench()
    bench.send(*data)
    assert bench.speeds_m_s == pytest.approx((left, right))


def test_no_wheel_runs_faster_than_it_can() -> None:
    bench = Bench()
    bench.send(137, 1, 244, 0, 129)
    assert bench.speeds_m_s == pytest.approx((0.0, 0.5))


@pytest.mark.parametrize("data", [[137, 2, 88, 128, 0], [137, 0, 100, 0, 0], [137, 0, 100, 8, 0]])
def test_drive_with_nonsense_is_refused(data: list[int]) -> None:
    bench = Bench()
    bench.send(*data)
    assert (bench.speeds_m_s, bench.roomba.refused) == ((0.0, 0.0), 1)


@pytest.mark.parametrize("mode", [Mode.OFF, Mode.PASSIVE])
def test_without_control_nothing_moves(mode: Mode) -> None:
    bench = Bench(mode=mode)
    bench.send(137, 1, 44, 128, 0)
    assert bench.speeds_m_s == (0.0, 0.0)
    assert bench.roomba.refused >= 1


@given(
    st.floats(0.02, 0.3),
    st.floats(0.1, 1.9),
    st.sampled_from([-1, 1]),
    st.sampled_from([-1, 1]),
)
def test_a_twist_is_driven_as_it_is_meant(speed_m_s: float, radius_m: float, ahead: int, side: int) -> None:
    bench = Bench()
    turn_rate_rad_s = ahead * side * speed_m_s / radius_m
    assume((speed_m_s + abs(turn_rate_rad_s) * 0.129) <= 0.5 and abs(turn_rate_rad_s) <= 3.14)
    bench.send(*sci.drive(*twist_drive(ahead * speed_m_s, turn_rate_rad_s)))
    left_m_s, right_m_s = bench.speeds_m_s
    assert (left_m_s + right_m_s) / 2 == pytest.approx(ahead * speed_m_s, abs=0.001)
    assert (right_m_s - left_m_s) / 0.258 == pytest.approx(turn_rate_rad_s, rel=0.035)


@given(st.builds(SciLights, *[st.booleans()] * 4, st.sampled_from(StatusLed), st.integers(0, 255), st.integers(0, 255)))
def test_lights_survive_the_wire(lights: SciLights) -> None:
    bench = Bench()
    bench.send(*lights.encode())
    assert bench.roomba.lights == lights


@given(st.integers(0, 15), st.lists(st.tuples(st.integers(31, 127), st.integers(0, 255)), min_size=1, max_size=16))
def test_songs_survive_the_wire(number: int, notes: list[tuple[int, int]]) -> None:
    bench = Bench()
    bench.send(*sci.song(number, notes))
    assert bench.roomba.songs == {number: tuple(notes)}


def test_a_command_may_arrive_byte_by_byte() -> None:
    bench = Bench()
    for byte in (137, 1, 44, 128):
        assert bench.send(byte) == b""
        assert bench.speeds_m_s == (0.0, 0.0)
    bench.send(0)
    assert bench.speeds_m_s == (0.3, 0.3)


@given(st.lists(st.integers(1, 6), max_size=30))
def test_it_does_not_matter_how_the_bytes_are_cut(sizes: list[int]) -> None:
    stream = bytes([140, 2, 2, 72, 16, 74, 32, 137, 0, 100, 128, 0, 139, 32, 7, 8, 142, 2, 141, 2, 142, 1, 142, 3])
    whole, cut = Bench(), Bench()
    expected = whole.send(*stream)
    replies, place = b"", 0
    for size in [*sizes, len(stream)]:
        replies += cut.send(*stream[place : place + size])
        place += size
    assert replies == expected
    assert vars(cut.roomba)["lights"] == vars(whole.roomba)["lights"]
    assert (cut.speeds_m_s, cut.roomba.playing(0.1)) == (whole.speeds_m_s, whole.roomba.playing(0.1))


@given(st.binary(max_size=60))
def test_noise_does_not_break_it(noise: bytes) -> None:
    bench = Bench()
    bench.send(*noise)
    bench.now_s += 1.0
    bench.send(*[0] * 40)  # whatever the noise began is over
    bench.now_s += 1.0
    bench.send(128)
    bench.now_s += 1.0
    assert len(bench.send(142, 0)) == 26


def test_distance_and_angle_count_from_the_last_reading() -> None:
    bench = Bench()
    bench.send(137, 0, 100, 128, 0)
    bench.now_s += 1.0
    assert bench.distance_and_angle() == (100, 0)
    assert bench.distance_and_angle() == (0, 0)
    bench.send(137, 0, 100, 0, 1)
    bench.now_s += 0.5
    assert bench.distance_and_angle() == (0, 50)
    bench.send(137, 0, 100, 255, 255)
    bench.now_s += 0.5
    assert bench.distance_and_angle() == (0, -50)


def test_other_groups_leave_the_counters_alone() -> None:
    bench = Bench()
    bench.send(137, 0, 100, 128, 0)
    bench.now_s += 1.0
    bench.send(142, 1, 142, 3)
    assert bench.distance_and_angle() == (100, 0)


@pytest.mark.parametrize("speed", [[0, 33], [255, 223]])
def test_what_is_below_a_millimetre_is_not_lost(speed: list[int]) -> None:
    bench = Bench()
    bench.send(137, *speed, 128, 0)
    total_mm = 0
    for _ in range(1000):  # 0.33 mm each
        bench.now_s += 0.01
        total_mm += bench.distance_and_angle()[0]
    assert abs(total_mm) == pytest.approx(330, abs=1)


def test_what_it_feels() -> None:
    bench = Bench()
    bench.body.bumped = (True, False)
    bench.body.by_wall = True
    bench.body.over_cliffs = (False, True, False, False)
    bench.roomba.pressed = frozenset({"clean"})
    assert Contacts.decode(bench.send(142, 1)) == Contacts(bump_left=True, wall=True, cliff_front_left=True)
    assert Controls.decode(bench.send(142, 2)) == Controls(button_clean=True)
    assert PowerGroup.decode(bench.send(142, 3)) == PowerGroup(0, 16100, -300, 24, 1350, 2700)


def test_a_battery_beyond_what_the_wire_holds_is_cut() -> None:
    bench = Bench()
    bench.body.charge = ConstantBattery(80.0, -99.0, -0.1, 99.0, 200.0)
    assert PowerGroup.decode(bench.send(142, 3)) == PowerGroup(0, 65535, -32768, 127, 0, 65535)


@pytest.mark.parametrize(
    ("drive", "falls"),
    [([137, 0, 100, 128, 0], True), ([137, 255, 56, 128, 0], False), ([137, 0, 100, 0, 1], False)],
    ids=["forward", "back", "in place"],
)
def test_in_safe_mode_a_cliff_ahead_ends_the_control(drive: list[int], falls: bool) -> None:
    bench = Bench()
    bench.send(*drive)
    bench.send(138, 7)
    bench.body.over_cliffs = (False, False, True, False)
    bench.roomba.update()
    assert bench.roomba.mode is (Mode.PASSIVE if falls else Mode.SAFE)
    assert (bench.speeds_m_s == (0.0, 0.0)) is falls
    assert bench.roomba.brushes == ((False,) * 3 if falls else (True,) * 3)


def test_in_safe_mode_a_dropped_wheel_ends_the_control() -> None:
    bench = Bench()
    bench.send(137, 255, 56, 128, 0)
    bench.body.dropped = (False, False, True)
    assert Contacts.decode(bench.send(142, 1)).drop_caster
    assert (bench.roomba.mode, bench.speeds_m_s) == (Mode.PASSIVE, (0.0, 0.0))


def test_in_full_mode_nothing_but_the_driver_stops_it() -> None:
    bench = Bench(mode=Mode.FULL)
    bench.send(137, 0, 100, 128, 0)
    bench.body.dropped, bench.body.over_cliffs = (True, True, True), (True, True, True, True)
    bench.send(142, 0)
    assert (bench.roomba.mode, bench.speeds_m_s) == (Mode.FULL, (0.1, 0.1))


def test_lights_brushes_and_songs() -> None:
    bench = Bench()
    bench.send(139, 0b110101, 10, 20)
    assert bench.roomba.lights == SciLights(
        dirt=True, clean=True, status=StatusLed.AMBER, power_colour=10, power_intensity=20
    )
    bench.send(138, 0b010)
    assert bench.roomba.brushes == (False, True, False)
    bench.send(140, 5, 2, 72, 32, 74, 96)
    bench.send(141, 5)
    assert bench.roomba.playing(bench.now_s + 1.99) == 5
    assert bench.roomba.playing(bench.now_s + 2.0) is None


def test_songs_that_are_refused() -> None:
    bench = Bench()
    bench.send(141, 1)
    bench.send(140, 16, 1, 72, 16)
    assert (bench.roomba.refused, bench.roomba.songs) == (2, {})
    bench.send(140, 1, 1, 72, 64)
    bench.send(141, 1)
    bench.send(141, 1)
    assert bench.roomba.refused == 3
    assert bench.roomba.playing(bench.now_s + 0.5) == 1


def test_a_song_may_have_rests() -> None:
    bench = Bench()
    bench.send(140, 1, 3, 72, 16, 30, 16, 128, 32)  # the specification: any note beyond 31..127 is a rest
    assert bench.roomba.songs == {1: ((72, 16), (30, 16), (128, 32))}
