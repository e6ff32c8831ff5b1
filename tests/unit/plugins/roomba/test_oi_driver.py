"""plugins/roomba: driver against emulator on a clock that tests move, and what must not move after a failure."""

from __future__ import annotations

import math

import pytest

from eal_actors.kernel.errors import NotReadyError, ResourceFaultError, UnavailableError
from eal_actors.plugin import EALData
from plugins.roomba.bodies import FreeRoombaBody
from plugins.roomba.oi import METRES_A_COUNT, STREAM_PERIOD_S, WHEELBASE_M
from plugins.roomba.oi_driver import STREAMED
from plugins.roomba.oi_emulator import OiEmulator
from plugins.roomba.packets import stream_frame
from plugins.roomba.panel import OiButtons, OiLeds, OiSong
from plugins.roomba.resources import OiWheelDrop, RoombaBattery, RoombaBump, RoombaOdometry, RoombaPower
from plugins.roomba.sci import Mode
from plugins.roomba.settings import BAUD_RATES
from tests.unit.plugins.roomba.oi_rig import STREAM, OiRig

STOP = bytes([145, 0, 0, 0, 0, 0])


def yaw_deg(rig: OiRig) -> float:
    left_m, right_m = rig.body.travel_m()
    return math.degrees((right_m - left_m) / WHEELBASE_M)


@pytest.mark.parametrize(
    ("mode", "sent"), [(Mode.SAFE, bytes([128, 131]) + STREAM), (Mode.FULL, bytes([128, 131, 132]) + STREAM)]
)
def test_it_wakes_step_by_step_and_has_its_sensors_streamed(mode: Mode, sent: bytes) -> None:
    rig = OiRig(mode, awake=False)
    rig.run(rig.roomba.wake())
    assert bytes(rig.port.sent) == sent
    assert (rig.emulator.mode, rig.emulator.violations, rig.emulator.refused) == (mode, 0, 0)
    rig.start_background()
    rig.take_sent()
    rig.wait(2.0)
    assert rig.take_sent() == b""  # the stream needs no asking
    assert rig.roomba.latest().power.voltage_mv == 16100
    assert rig.roomba.mode is mode


@pytest.mark.parametrize("baud_rate", BAUD_RATES["oi"])
def test_a_frame_of_the_stream_is_over_before_the_next_one(baud_rate: int) -> None:
    frame = stream_frame(dict.fromkeys(STREAMED, 0), STREAM[2:])
    assert len(frame) * 10 / baud_rate < STREAM_PERIOD_S


@pytest.mark.parametrize("poll_hz", [5, 20, 50])
@pytest.mark.parametrize(
    ("text", "expected_m"), [("g", 0.5), ("b", -0.5), ("f1.25", 1.25), ("f0.01", 0.01), ("f0", 0.0)]
)
def test_distances(text: str, expected_m: float, poll_hz: float) -> None:
    rig = OiRig(poll_hz=poll_hz)
    rig.do(text)
    assert rig.body.travel_m() == pytest.approx((expected_m, expected_m), abs=0.003)
    assert (rig.emulator.violations, rig.emulator.refused) == (0, 0)


@pytest.mark.parametrize("poll_hz", [5, 20, 50])
@pytest.mark.parametrize(("text", "expected_deg"), [("l", 90), ("r", -90), ("r5", -5), ("l360", 360)])
def test_turns(text: str, expected_deg: float, poll_hz: float) -> None:
    rig = OiRig(poll_hz=poll_hz)
    rig.do(text)
    assert yaw_deg(rig) == pytest.approx(expected_deg, abs=1.0)


def test_the_square_ends_where_it_began_and_it_knows() -> None:
    rig = OiRig()
    rig.do(*["g", "l"] * 4)
    x_m, y_m, yaw_rad = rig.body.pose
    assert math.hypot(x_m, y_m) < 0.015
    assert yaw_rad == pytest.approx(0.0, abs=math.radians(2))
    assert RoombaOdometry(rig.roomba).get_value().value == pytest.approx([x_m, y_m, yaw_rad], abs=0.01)


def test_encoders_that_wrap_are_followed() -> None:
    rig = OiRig()
    rig.base.set_config("speed_m_s", EALData.of(0.5))
    rig.do("f35", "b10")
    assert rig.roomba.latest().left_m == pytest.approx(25.0, abs=0.01)


def test_a_calibration_is_made_up_for_wheel_by_wheel() -> None:
    rig = OiRig()
    rig.base.set_config("wheel_ratio", EALData.of(1.05))
    rig.base.set_config("track_factor", EALData.of(1.1))
    rig.do("f1")
    left_m, right_m = rig.body.travel_m()
    assert left_m / right_m == pytest.approx(1.05, abs=0.005)
    rig = OiRig()
    rig.base.set_config("track_factor", EALData.of(1.1))
    rig.do("l90")
    assert yaw_deg(rig) == pytest.approx(99.0, abs=1.0)


def test_twists_go_to_each_wheel() -> None:
    rig = OiRig()
    twist = rig.base.set_value(EALData.of([0.2, 0.4]))
    rig.start(twist, 0.3)
    assert (rig.body.left.target_m_s, rig.body.right.target_m_s) == pytest.approx((0.153, 0.247))
    rig.run(twist)
    assert rig.body.right.target_m_s == 0.0


@pytest.mark.parametrize("mode", [Mode.SAFE, Mode.FULL])
def test_a_cliff_while_turning_is_let_be_and_one_ahead_halts(mode: Mode) -> None:
    rig = OiRig(mode)
    rig.body.over_cliffs = (True, False, False, False)
    rig.wait(0.1)
    rig.do("l90")  # backing off and turning away must be possible
    drive = rig.base.send_cmd("f5")
    with pytest.raises(ResourceFaultError, match=r"^halted: cliff \(left\)$"):
        rig.run(drive)
    rig.wait(1.0)
    assert (rig.body.left.speed_m_s, rig.body.right.speed_m_s) == (0.0, 0.0)


def test_a_wheel_drop_while_turning_halts_and_the_next_command_takes_control_again() -> None:
    rig = OiRig()
    turn = rig.begin("l360", 1.0)
    rig.body.dropped = (False, True, False)
    with pytest.raises(ResourceFaultError, match=r"^halted: wheel drop \(right wheel\)$"):
        rig.run(turn)
    assert OiWheelDrop(rig.roomba).send_req("right").value is True
    rig.wait(1.0)
    assert (rig.emulator.mode, rig.roomba.mode, rig.body.right.speed_m_s) == (Mode.PASSIVE, Mode.PASSIVE, 0.0)
    rig.body.dropped = (False,) * 3
    rig.wait(0.2)
    rig.do("f0.1")
    assert (rig.emulator.mode, rig.emulator.violations) == (Mode.SAFE, 0)


@pytest.mark.parametrize("lost", range(5))
def test_a_stop_that_loses_a_byte_leaves_nothing_that_the_next_command_could_complete(lost: int) -> None:
    rig = OiRig()
    rig.do("f0.1")
    rig.take_sent()
    rig.roomba.stop()
    stop = rig.take_sent()
    rig.emulator.feed(stop[:lost] + stop[lost + 1 :], rig.clock.now())
    before = rig.body.travel_m()
    rig.emulator.feed(STREAM, rig.clock.now())
    rig.clock.advance(0.5)
    assert rig.body.travel_m() == pytest.approx(before, abs=1e-4)


def test_a_button_that_takes_it_out_of_control_ends_the_motion() -> None:
    rig = OiRig()
    drive = rig.begin("f5", 1.0)
    rig.emulator.pressed = frozenset({"clean"})
    rig.emulator.feed(bytes([135]), rig.clock.now())  # CLEAN
    with pytest.raises(
        ResourceFaultError, match=r"^halted: the Roomba has left its safe mode: a button, the charger, or a drop$"
    ):
        rig.run(drive)
    modes = [rig.emulator.mode]
    rig.wait(0.2)
    rig.do("f0.1")
    assert [*modes, rig.emulator.mode] == [Mode.PASSIVE, Mode.SAFE]


def test_an_emulator_that_freezes_ends_the_motion_and_is_stopped_when_it_is_back() -> None:
    rig = OiRig()
    drive = rig.begin("f5", 1.0)
    rig.port.is_cut = True
    rig.take_sent()
    with pytest.raises(UnavailableError, match="the Roomba on memory does not answer"):
        rig.run(drive)
    assert rig.take_sent().endswith(STOP)
    rig.wait(2.0)
    assert rig.roomba.not_ready() is not None
    rig.port.is_cut = False
    rig.wait(2.0)
    assert rig.roomba.not_ready() is None
    assert rig.body.left.speed_m_s == 0.0
    rig.do("f0.1")


def test_a_port_closed_in_the_middle_of_a_frame_ends_the_motion_and_the_travel_goes_on() -> None:
    rig = OiRig()
    drive = rig.begin("f5", 1.0)
    rig.port.arrive(bytes([19, 42, 7]))  # the beginning of a frame
    rig.port.is_broken = True
    with pytest.raises(NotReadyError, match="memory was lost"):
        rig.run(drive)
    rig.wait(0.5)
    rig.port.come_back()
    rig.wait(1.0)
    assert (rig.emulator.mode, rig.body.left.speed_m_s) == (Mode.PASSIVE, 0.0)
    assert rig.roomba.latest().left_m == pytest.approx(rig.body.travel_m()[0], abs=2 * METRES_A_COUNT)
    rig.do("b0.1")


def test_another_robot_at_the_same_port_moves_nobody() -> None:
    rig = OiRig()
    rig.do("f0.2")
    rig.port.is_broken = True
    rig.wait(0.5)
    rig.port.emulator = rig.emulator = OiEmulator(rig.body)
    rig.body.left.travel_m += 20.0  # its encoders are elsewhere
    rig.port.come_back()
    rig.wait(1.0)
    assert rig.roomba.latest().left_m == pytest.approx(0.2, abs=0.003)


@pytest.mark.parametrize("absence_s", [1.0, 5.0, 30.0, 3600.0])
@pytest.mark.parametrize("is_driven", [False, True])
def test_a_robot_that_was_switched_off_for_long_counts_anew(absence_s: float, is_driven: bool) -> None:
    rig = OiRig()
    rig.do("f4")
    drive = rig.begin("f4", 1.0) if is_driven else None
    before_m = rig.roomba.latest().left_m
    rig.port.is_cut = True
    if drive is not None:
        with pytest.raises(UnavailableError):
            rig.run(drive)
    rig.wait(absence_s)
    rig.port.emulator = rig.emulator = OiEmulator(FreeRoombaBody(rig.clock.now, WHEELBASE_M))
    rig.port.is_cut = False
    rig.wait(3.0)
    assert rig.roomba.not_ready() is None
    assert rig.roomba.latest().left_m == pytest.approx(before_m, abs=0.05)


def test_a_robot_that_drives_on_while_its_program_is_held_up_is_followed() -> None:
    rig = OiRig()
    rig.base.set_config("twist_timeout_s", EALData.of(10.0))
    rig.start(rig.base.set_value(EALData.of([0.3, 0.0])), 0.02)  # no frame has shown the command yet
    rig.clock.advance(4.0)
    rig.wait(0.1)
    assert rig.roomba.latest().left_m == pytest.approx(rig.body.travel_m()[0], abs=0.05)
    assert rig.roomba.latest().left_m > 1.0


def test_a_motion_whose_travel_is_unknown_after_its_stop_fails() -> None:
    rig = OiRig()
    drive = rig.begin("f0.1", 0.2)
    rig.take_sent()
    while STOP not in rig.port.sent:
        rig.wait(next(drive))
    rig.body.left.travel_m += 20.0  # its encoders are reset while it comes to rest
    with pytest.raises(ResourceFaultError, match="may be wrong by"):
        rig.run(drive)
    rig.do("b0.1")


def test_a_battery_that_runs_out_ends_the_motion() -> None:
    rig = OiRig()
    drive = rig.begin("f5", 1.0)
    rig.body.charge.charge_ah = 0.0
    rig.wait(0.1)
    assert RoombaBattery(rig.roomba).get_value().value == 0.0
    rig.emulator._has_device_detect = rig.emulator.is_asleep = True  # it switches itself off, and no byte wakes it
    rig.body.drive(0.0, 0.0)
    with pytest.raises(UnavailableError, match="does not answer"):
        rig.run(drive)
    rig.wait(3.0)
    rig.body.travel_m()
    assert rig.body.left.speed_m_s == 0.0


def test_noise_on_the_line_costs_a_frame_and_no_more() -> None:
    rig = OiRig()
    for noise in (b"\x13", b"\x13\xff", bytes(range(256))):
        rig.port.arrive(noise)
        rig.wait(0.5)
        assert rig.clock.now() - rig.roomba.latest().stamp_s < 0.1
    contacts = rig.roomba.latest().contacts
    assert (contacts.bump_left, contacts.bump_right) == (False, False)


def test_released_it_stands_in_passive_mode_and_streams_no_more() -> None:
    rig = OiRig()
    _drive = rig.begin("f5", 1.0)
    rig.take_sent()
    rig.base.close()
    assert rig.take_sent() == STOP + bytes([128, 150, 0])
    rig.run(rig.roomba.farewell())
    rig.roomba.close()
    assert (rig.emulator.mode, rig.port.is_open) == (Mode.PASSIVE, False)


def test_it_sleeps_and_wakes() -> None:
    rig = OiRig(has_device_detect=True)
    power = RoombaPower(rig.roomba)
    rig.run(power.send_cmd("sleep"))
    rig.wait(5.0)
    assert (rig.emulator.is_asleep, power.get_status()) == (True, 0)
    rig.run(power.send_cmd("wake"))
    assert (rig.emulator.is_asleep, power.get_status(), RoombaBump(rig.roomba).not_ready()) == (False, 1, None)
    rig.do("f0.1")


def test_lights_buttons_and_more_songs_than_it_keeps() -> None:
    rig = OiRig()
    leds, song, buttons = OiLeds(rig.roomba), OiSong(rig.roomba), OiButtons(rig.roomba)
    rig.run(leds.send_cmd("dock", EALData.of(True)))
    rig.run(leds.send_cmd("power_intensity200"))
    assert (rig.emulator.lights.dock, rig.emulator.lights.power_intensity) == (True, 200)
    assert leds.send_req("dock") is True
    for number in (1, 5):  # both have the place 1
        song.set_config("number", EALData.of(number))
        rig.run(song.send_cmd("notes", EALData.of(f"{60 + number}:16")))
    song.set_config("number", EALData.of(1))
    rig.run(song.send_cmd("play"))
    assert rig.emulator.songs[1] == ((61, 16),)
    assert rig.emulator.playing(rig.clock.now()) == 1
    rig.emulator.pressed = frozenset({"dock"})
    rig.wait(0.1)
    assert (buttons.get_value().value, buttons.send_req("dock").value, buttons.send_req("day").value) == (
        True,
        True,
        False,
    )
