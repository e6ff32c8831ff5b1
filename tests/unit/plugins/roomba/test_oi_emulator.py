"""plugins/roomba: the emulator, byte by byte, as the document has it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.roomba.bodies import FreeRoombaBody
from plugins.roomba.oi import WHEELBASE_M, OiLights
from plugins.roomba.oi_emulator import OiEmulator
from plugins.roomba.packets import GROUPS, StreamReader, decode
from plugins.roomba.sci import Mode


class Bench:
    """An emulator on a table: bytes go in, the time passes when the test says so."""

    def __init__(self, *begin: int) -> None:
        self.now_s = 0.0
        self.body = FreeRoombaBody(lambda: self.now_s, WHEELBASE_M, acceleration_m_s2=1e9)
        self.roomba = OiEmulator(self.body)
        for byte in begin:
            self.feed(byte)
            self.now_s += 0.03

    def feed(self, *data: int) -> bytes:
        return self.roomba.feed(bytes(data), self.now_s)

    def ask(self, group: int) -> dict[int, int]:
        return decode(GROUPS.get(group, (group,)), self.feed(142, group))


@pytest.mark.parametrize(
    ("begin", "op", "mode"),
    [
        ((), 128, Mode.PASSIVE),
        ((), 131, Mode.OFF),  # nothing but Start is heard at first
        ((128,), 131, Mode.SAFE),
        ((128,), 132, Mode.FULL),  # not by way of safe mode, as with the older interface
        ((128, 132), 131, Mode.SAFE),
        ((128, 131), 128, Mode.PASSIVE),
        ((128, 131), 135, Mode.PASSIVE),
        ((128, 131), 143, Mode.PASSIVE),
        ((128, 131), 173, Mode.OFF),
        ((128, 131), 7, Mode.OFF),
    ],
)
def test_modes(begin: tuple[int, ...], op: int, mode: Mode) -> None:
    bench = Bench(*begin, op)
    assert bench.roomba.mode is mode
    if mode is not Mode.OFF:
        assert bench.ask(35) == {35: {Mode.PASSIVE: 1, Mode.SAFE: 2, Mode.FULL: 3}[mode]}
    else:
        assert bench.feed(142, 35) == b""


def test_after_a_change_of_mode_it_is_deaf_for_20_ms() -> None:
    bench = Bench()
    bench.feed(128, 131)
    assert (bench.roomba.mode, bench.roomba.violations) == (Mode.PASSIVE, 1)


def test_drive_direct_has_the_right_wheel_first_and_the_encoders_count() -> None:
    bench = Bench(128, 131)
    bench.feed(145, 0, 200, 0, 100)
    bench.now_s += 1.0
    assert bench.body.travel_m() == pytest.approx((0.1, 0.2))
    counted = bench.ask(101)
    assert (counted[43], counted[44]) == (224, 449)  # of 0.44456 mm
    asked = bench.ask(5)
    assert (asked[41], asked[42]) == (200, 100)
    moved = bench.ask(2)
    assert (moved[19], moved[20]) == (150, 24)  # mm, and degrees
    assert bench.ask(2)[19] == 0


def test_encoders_wrap_at_16_bits() -> None:
    bench = Bench(128, 131)
    bench.feed(145, 255, 56, 1, 244)  # -200 and 500
    bench.now_s += 60.0
    counted = bench.ask(101)
    assert counted[43] == int(30.0 / 0.000444563) % 65536
    assert counted[44] == 65536 - int(12.0 / 0.000444563) - 1


def test_drive_with_a_radius_is_driven_with_its_own_wheelbase() -> None:
    bench = Bench(128, 131)
    bench.feed(137, 255, 56, 1, 244)  # the document's example: -200 mm/s at 500 mm
    assert (bench.body.left.target_m_s, bench.body.right.target_m_s) == pytest.approx((-0.153, -0.247))
    assert (bench.ask(39), bench.ask(40)) == ({39: -200}, {40: 500})


def test_the_stream_comes_every_15_ms_until_it_is_paused() -> None:
    bench = Bench(128)
    reader = StreamReader()
    assert reader.feed(bench.feed(148, 2, 29, 13)) == [{29: 2600, 13: 0}]
    frames = 0
    for _ in range(300):
        bench.now_s += 0.001
        frames += len(reader.feed(bench.feed()))
    assert frames == 20
    bench.feed(150, 0)
    bench.now_s += 1.0
    assert bench.feed() == b""
    assert reader.feed(bench.feed(150, 1)) == [{29: 2600, 13: 0}]
    bench.feed(173)
    bench.now_s += 1.0
    assert bench.feed() == b""


def test_a_query_list_is_answered_once() -> None:
    bench = Bench(128)
    assert bench.feed(149, 3, 35, 22, 9) == bytes([1, 0x3E, 0xE4, 0])
    assert bench.feed() == b""


def test_what_makes_no_sense_is_complained_of() -> None:
    bench = Bench(128, 131)
    for command in ((142, 59), (148, 1, 200), (145, 2, 0, 0, 0), (99,), (140, 5, 1, 60, 1)):
        assert bench.feed(*command) == b""
    assert list(bench.roomba.complaints) == [
        "OI: there is no sensor packet 59",
        "OI: there is no sensor packet 200",
        "Drive Direct at 0 and 512 mm/s",
        "byte 99 is no op code",
        "song 5 of 1 notes",
    ]


def test_what_the_body_feels() -> None:
    bench = Bench(128)
    bench.body.bumped, bench.body.dropped = (True, False), (False, True, True)
    bench.body.over_cliffs, bench.body.by_wall = (True, False, False, True), True
    sees = bench.ask(6)
    assert (sees[7], sees[8]) == (0b0110, 1)
    assert [sees[packet] for packet in (9, 10, 11, 12)] == [1, 0, 0, 1]
    assert [sees[packet] for packet in (28, 29, 30, 31)] == [0, 2600, 2600, 0]
    assert [sees[packet] for packet in (22, 23, 24, 25, 26)] == [16100, -300, 24, 1350, 2700]


@pytest.mark.parametrize(
    ("dropped", "cliffs"), [((True, False, False), (False,) * 4), ((False,) * 3, (False, True, False, False))]
)
def test_in_safe_mode_a_drop_or_a_cliff_ahead_ends_the_control(
    dropped: tuple[bool, bool, bool], cliffs: tuple[bool, bool, bool, bool]
) -> None:
    bench = Bench(128, 131)
    bench.feed(145, 0, 200, 0, 200)
    bench.body.dropped, bench.body.over_cliffs = dropped, cliffs
    bench.feed()
    assert (bench.roomba.mode, bench.body.left.target_m_s) == (Mode.PASSIVE, 0.0)


def test_lights_digits_buttons_and_songs() -> None:
    bench = Bench(128, 131)
    bench.feed(139, 0b1010, 7, 255)
    bench.feed(164, *b"ROBO")
    bench.feed(140, 3, 2, 72, 32, 76, 32)
    bench.feed(141, 3)
    bench.roomba.pressed = frozenset({"clock", "clean"})
    assert bench.roomba.lights == OiLights(spot=True, check_robot=True, power_colour=7, power_intensity=255)
    assert bench.roomba.digits == b"ROBO"
    assert (bench.ask(36), bench.ask(37), bench.ask(18)) == ({36: 3}, {37: 1}, {18: 0b10000001})
    bench.now_s += 1.01
    assert bench.ask(37) == {37: 0}


@given(st.lists(st.binary(max_size=40), max_size=8))
def test_any_bytes_never_crash_it_and_it_can_be_stopped(pieces: list[bytes]) -> None:
    bench = Bench(128, 131)
    for piece in pieces:
        bench.feed(*piece)
        bench.now_s += 0.03
    for _ in range(2):  # the first of them may be the data of Baud, after which it is deaf for a while
        bench.now_s += 0.2
        bench.feed(*[0] * 600)  # whatever has begun is at an end, or was refused
    bench.now_s += 0.2
    for byte in (128, 131):
        bench.now_s += 0.03
        bench.feed(byte)
    bench.now_s += 0.03
    bench.feed(145, 0, 0, 0, 0)
    assert (bench.body.left.target_m_s, bench.body.right.target_m_s) == (0.0, 0.0)
    assert bench.roomba.mode is Mode.SAFE


def test_baud_keeps_the_mode() -> None:
    bench = Bench(128, 131)
    bench.feed(129, 11)
    assert (bench.roomba.mode, bench.roomba.baud_rate) == (Mode.SAFE, 115200)


@pytest.mark.parametrize("radius", [(0x7F, 0xFF), (0x80, 0x00)])
def test_both_special_radii_are_straight(radius: tuple[int, int]) -> None:
    bench = Bench(128, 131)
    bench.feed(137, 0, 200, *radius)
    bench.now_s += 1.0
    assert bench.body.travel_m() == pytest.approx((0.2, 0.2), abs=1e-3)
    assert bench.roomba.refused == 0


@pytest.mark.parametrize(
    "command", [(144, 127, 0, 0), (168, 1, 7, 30), (167, *[1] * 15)], ids=["motors", "time", "schedule"]
)
def test_commands_whose_data_looks_like_op_codes_are_taken_whole(command: tuple[int, ...]) -> None:
    bench = Bench(128, 131)
    bench.feed(*command)
    bench.now_s += 0.03
    assert (bench.roomba.mode, bench.roomba.refused, bench.ask(35)) == (Mode.SAFE, 0, {35: 2})


def test_pwm_motors_switch_the_brushes() -> None:
    bench = Bench(128, 131)
    bench.feed(144, 127, 0, 0)
    assert bench.roomba.brushes == (False, False, True)


def test_a_song_may_have_rests() -> None:
    bench = Bench(128, 131)
    bench.feed(140, 1, 3, 72, 16, 0, 16, 76, 32)
    assert bench.roomba.songs[1] == ((72, 16), (0, 16), (76, 32))


def test_a_streamed_group_comes_under_its_own_number() -> None:
    bench = Bench(128, 131)
    frame = bench.feed(148, 2, 2, 35)
    assert (frame[0], frame[1], frame[2], frame[9]) == (19, 9, 2, 35)  # group 2 has 6 bytes
    assert len(frame) == 12
    assert sum(frame) & 0xFF == 0
    (values,) = StreamReader().feed(frame)
    assert set(values) == {17, 18, 19, 20, 35}


def test_reset_prints_what_it_is() -> None:
    bench = Bench(128, 131)
    assert bench.feed(7).startswith(b"bl-start\r\nSTR730\r\n")
    assert bench.roomba.mode is Mode.OFF
