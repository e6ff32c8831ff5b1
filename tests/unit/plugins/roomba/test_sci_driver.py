"""plugins/roomba: modes, polling and age of readings, driver against emulator on a clock that tests move."""

from __future__ import annotations

import pytest

from eal_actors.kernel.errors import NotReadyError, ResourceFaultError, UnavailableError
from plugins.roomba import sci
from plugins.roomba.groups import Contacts, Controls, PowerGroup, Sensors
from plugins.roomba.resources import RoombaBump, RoombaPower
from plugins.roomba.sci import Mode, Op
from tests.unit.plugins.roomba.rig import Rig, without_polls

VACUUM_ON, MOTORS_OFF = bytes([138, 2]), bytes([138, 0])


@pytest.mark.parametrize(("mode", "sent"), [(Mode.SAFE, [128, 130, 142, 0]), (Mode.FULL, [128, 130, 132, 142, 0])])
def test_it_wakes_step_by_step(mode: Mode, sent: list[int]) -> None:
    rig = Rig(mode, awake=False)
    rig.run(rig.roomba.wake())
    assert list(rig.port.sent) == sent
    assert (rig.emulator.mode, rig.emulator.violations, rig.emulator.refused) == (mode, 0, 0)
    assert rig.roomba.latest().power.voltage_mv == 16100


def test_when_nothing_answers_it_says_so_and_names_the_port() -> None:
    rig = Rig(awake=False)
    rig.port.is_cut = True
    rig.run(rig.roomba.wake())
    assert rig.clock.now() < 1.2
    reason = "nothing answers on memory: is the Roomba on and connected, and is the baud rate right?"
    assert rig.roomba.not_ready() == reason
    with pytest.raises(NotReadyError, match="nothing answers on memory"):
        rig.roomba.latest()


def test_a_roomba_that_is_switched_on_later_is_found() -> None:
    rig = Rig(awake=False)
    rig.port.is_cut = True
    rig.run(rig.roomba.wake())
    rig.start_background()
    rig.wait(3.0)
    rig.port.is_cut = False
    rig.wait(1.0)
    assert rig.roomba.not_ready() is None
    rig.do("f0.1")
    assert rig.roomba.latest().left_m == pytest.approx(0.1, abs=0.003)


def test_what_wakes_late_is_waited_for() -> None:
    rig = Rig(awake=False)
    rig.port.is_cut = True
    waking = rig.roomba.wake()
    rig.start(waking, 0.2)
    rig.port.is_cut = False
    rig.run(waking)
    assert rig.emulator.mode is Mode.SAFE


def test_it_is_polled_at_its_rate() -> None:
    rig = Rig(poll_hz=10)
    rig.take_sent()
    rig.wait(1.0)
    assert rig.take_sent() == bytes([142, 0] * 10)
    assert rig.emulator.violations == 0


@pytest.mark.parametrize(("poll_hz", "lasts_s"), [(20, 0.5), (5, 0.6)])
def test_a_reading_counts_for_three_polls_or_half_a_second_and_no_longer(poll_hz: float, lasts_s: float) -> None:
    rig = Rig(poll_hz=poll_hz)
    rig.wait(0.2)
    rig.port.is_cut = True
    asked_s = rig.roomba.latest().stamp_s
    rig.wait(asked_s + lasts_s - 0.001 - rig.clock.now())
    assert rig.roomba.latest().stamp_s == asked_s
    rig.wait(0.01)
    with pytest.raises(UnavailableError, match=rf"memory does not answer: .* s old, and counts for {lasts_s:.2f} s"):
        rig.roomba.latest()


def test_before_the_first_reading_there_is_no_answer() -> None:
    with pytest.raises(NotReadyError, match="nothing answers on memory"):
        Rig(awake=False).roomba.latest()


def test_after_a_silence_it_is_started_anew_and_its_travel_goes_on() -> None:
    rig = Rig()
    rig.do("f0.2")
    rig.port.is_cut = True
    rig.wait(3.0)
    rig.emulator.mode = Mode.OFF  # somebody took the battery out
    rig.port.is_cut = False
    rig.wait(2.0)
    modes = [rig.emulator.mode]
    assert rig.roomba.latest().left_m == pytest.approx(0.2, abs=0.003)
    rig.do("b0.2")
    assert [*modes, rig.emulator.mode] == [Mode.PASSIVE, Mode.SAFE]
    assert rig.roomba.latest().left_m == pytest.approx(0.0, abs=0.003)


def test_noise_on_the_line_costs_a_reading_and_no_more() -> None:
    rig = Rig()
    rig.port.arrive(bytes([0xFF] * 7))  # left over when the next reading is asked for
    rig.wait(0.2)
    assert rig.clock.now() - rig.roomba.latest().stamp_s < 0.06
    rig.port.is_cut = True
    rig.wait(0.06)
    rig.port.arrive(bytes([0xFF] * 26))  # in place of the reply
    rig.port.is_cut = False
    rig.wait(0.4)
    assert rig.clock.now() - rig.roomba.latest().stamp_s < 0.06
    contacts = rig.roomba.latest().contacts
    assert (contacts.bump_left, contacts.bump_right) == (False, False)


def test_a_port_that_breaks_is_named() -> None:
    rig = Rig()
    drive = rig.begin("f5", 1.0)
    rig.port.is_broken = True
    with pytest.raises(NotReadyError, match="memory was lost: input/output error"):
        rig.run(drive)
    assert rig.roomba.not_ready() == "memory was lost: input/output error"
    with pytest.raises(NotReadyError, match="memory was lost"):  # it may be moving, and that must not go unsaid
        rig.base.halt()


def test_a_roomba_that_comes_back_is_stopped_and_greeted_and_its_travel_goes_on() -> None:
    rig = Rig()
    drive = rig.begin("f5", 1.0)
    rig.port.is_broken = True
    with pytest.raises(NotReadyError):
        rig.run(drive)
    rig.wait(1.0)
    assert rig.body.left.speed_m_s > 0  # nobody could tell it to stop
    rig.port.come_back()
    rig.wait(1.0)
    assert (rig.body.left.speed_m_s, rig.emulator.mode) == (0.0, Mode.PASSIVE)
    assert rig.roomba.not_ready() is None
    assert rig.roomba.latest().left_m == pytest.approx(rig.body.travel_m()[0], abs=0.002)
    rig.do("b0.1")
    assert (rig.emulator.mode, rig.emulator.violations) == (Mode.SAFE, 0)


def test_a_command_brings_it_back_under_control() -> None:
    rig = Rig()
    rig.body.dropped = (True, False, False)
    rig.wait(0.1)
    rig.body.dropped = (False, False, False)
    rig.wait(0.1)
    assert rig.emulator.mode is Mode.PASSIVE
    rig.take_sent()
    rig.run(rig.roomba.command(sci.SciLights(dirt=True).encode()))
    assert list(without_polls(rig.take_sent())) == [130, 139, 1, 0, 0]
    assert rig.emulator.lights.dirt
    assert rig.emulator.violations == 0


def test_in_safe_mode_a_dropped_wheel_refuses_every_command() -> None:
    rig = Rig()
    rig.body.dropped = (False, False, True)
    rig.wait(0.1)
    with pytest.raises(ResourceFaultError, match="a wheel has dropped"):
        rig.run(rig.roomba.command(sci.play(0)))


def test_commands_during_a_change_of_mode_wait_for_its_end() -> None:
    rig = Rig()
    rig.roomba.release()
    one, other = rig.roomba.command(sci.play(1)), rig.roomba.command(VACUUM_ON)
    rig.start(one, 0.03)  # Start has been waited for, Control is under way
    rig.run(other)
    rig.run(one)
    assert (rig.emulator.mode, rig.emulator.violations) == (Mode.SAFE, 0)
    assert rig.emulator.brushes == (False, True, False)


def test_released_it_stands_in_passive_mode() -> None:
    rig = Rig()
    _drive = rig.begin("f5", 1.0)
    rig.take_sent()
    rig.roomba.release()
    assert list(rig.take_sent()) == [137, 0, 0, 0, 1, Op.START]
    assert rig.emulator.mode is Mode.PASSIVE
    assert rig.body.left.target_m_s == 0.0
    rig.roomba.close()
    assert not rig.port.is_open
    assert rig.take_sent() == b""


def test_control_that_was_taken_after_the_release_is_given_back_at_the_end() -> None:
    rig = Rig()
    rig.roomba.release()
    rig.run(rig.roomba.command(VACUUM_ON))
    rig.run(rig.roomba.farewell())
    rig.roomba.close()
    assert (rig.emulator.mode, rig.emulator.brushes) == (Mode.PASSIVE, (False, False, False))
    assert not rig.port.is_open


def test_a_broken_port_is_closed_all_the_same() -> None:
    rig = Rig()
    rig.port.is_broken = True
    rig.roomba.release()
    rig.run(rig.roomba.farewell())
    rig.roomba.close()
    assert not rig.port.is_open


def test_a_stop_is_repeated_until_it_is_seen_to_stand() -> None:
    rig = Rig()
    drive = rig.begin("f5", 1.0)
    rig.port.is_cut = True
    drive.close()
    rig.port.is_cut = False
    assert rig.body.left.target_m_s == 0.3  # that one was lost
    rig.wait(0.3)
    assert rig.body.left.target_m_s == 0.0
    rig.wait(1.0)
    rig.take_sent()
    rig.wait(1.0)
    assert without_polls(rig.take_sent()) == b""


def test_it_sleeps_and_is_woken_by_its_line() -> None:
    rig = Rig(has_device_detect=True)
    power, bump = RoombaPower(rig.roomba), RoombaBump(rig.roomba)
    assert (power.get_status(), power.mode(), power.charging()) == (1, "safe", "not charging")
    rig.run(power.send_cmd("sleep"))
    rig.wait(5.0)
    assert (rig.emulator.is_asleep, power.get_status(), power.mode()) == (True, 0, "off")
    assert bump.not_ready() == "the Roomba sleeps; the command wake of its resource Power wakes it"
    assert power.not_ready() is None
    rig.take_sent()
    rig.run(power.send_cmd("wake"))
    assert list(rig.take_sent()[:3]) == [128, 142, 0]
    assert (rig.emulator.is_asleep, power.get_status(), bump.not_ready()) == (False, 1, None)
    rig.do("f0.1")


def test_one_that_does_not_wake_up_is_not_ready() -> None:
    rig = Rig()
    power = RoombaPower(rig.roomba)
    rig.run(power.send_cmd("sleep"))
    rig.port.is_cut = True
    with pytest.raises(NotReadyError, match="the Roomba on memory does not answer"):
        rig.run(power.send_cmd("wake"))


def test_on_the_charger_the_next_command_takes_control_anew() -> None:
    rig = Rig()
    power = PowerGroup(2, 16100, 800, 24, 1350, 2700)
    reply = Sensors(Contacts(), Controls(), power).encode()  # charging
    rig.port.is_cut = True
    rig.wait(0.06)
    rig.port.arrive(reply)
    rig.wait(0.01)
    rig.port.is_cut = False
    rig.take_sent()
    rig.run(rig.roomba.command(MOTORS_OFF))
    assert list(without_polls(rig.take_sent())) == [130, 138, 0]


def test_a_wait_that_ends_a_rounding_too_early_is_over() -> None:
    rig = Rig()
    rig.roomba.release()
    rig.take_sent()
    command = rig.roomba.command(MOTORS_OFF)
    rig.clock.advance(next(command) - 1e-9)
    assert next(command) > 0.02
    assert rig.take_sent() == bytes([130])
