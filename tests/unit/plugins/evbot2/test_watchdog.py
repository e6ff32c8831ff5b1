"""The watchdog time follows the measured round trips; a starved emulator does not blame its host."""

from __future__ import annotations

import pytest

from eal_actors.kernel.errors import NotReadyError, UnavailableError
from plugins.evbot2.serving import DeviceTime
from plugins.evbot2.watchdog import LEAST_S, MOST_S, WatchdogTime
from tests.manual_clock import ManualClock
from tests.unit.plugins.evbot2.rig import Rig


def drive_while_starved(rig: Rig) -> None:
    """Drive a metre on a computer that lets the driver run for a moment only now and then, less and less often."""
    motion = rig.start(rig.base.send_cmd("f1"), 0.2)
    for starved_s in (0.1, 0.2, 0.3, 0.4, 0.6, 0.9, 0.9):
        rig.silence(starved_s)
        rig.wait(0.3)
    assert rig.result(motion) == 1


def test_a_busy_computer_does_not_stop_the_base() -> None:
    rig = Rig()
    rig.wait(1.0)
    assert rig.session.watchdog_s == LEAST_S
    drive_while_starved(rig)
    assert rig.body.pose[0] == pytest.approx(1.0, abs=0.002)
    assert rig.session.watchdog_s == MOST_S


def test_a_fixed_time_stays_and_stops_it() -> None:
    rig = Rig(watchdog_s=0.5)
    rig.wait(1.0)
    with pytest.raises(UnavailableError):
        drive_while_starved(rig)
    assert rig.session.watchdog_s == 0.5


def test_it_falls_again_when_the_computer_is_idle_and_the_base_knows() -> None:
    rig = Rig()
    rig.wait(1.0)
    drive_while_starved(rig)
    rig.wait(10.0)
    assert rig.session.watchdog_s == LEAST_S
    rig.start(rig.base.send_cmd("f3"), 1.0)
    rig.silence(LEAST_S + 0.2)
    before = rig.body.travel_m()
    rig.silence(2.0)
    assert rig.body.travel_m() == pytest.approx(before, abs=0.2)  # it has stopped, or comes to rest
    rig.silence(1.0)
    assert not rig.device.is_busy


def test_a_stop_that_waits_for_its_acknowledgement_is_no_slow_computer() -> None:
    rig = Rig()
    motion = rig.start(rig.base.send_cmd("f1"), 1.0)
    rig.port.is_deaf = True
    rig.close(motion)
    rig.wait(0.3)
    rig.port.is_deaf = False
    rig.wait(0.3)
    assert rig.session.watchdog_s == LEAST_S


def test_it_is_never_longer_than_what_is_safe_nor_shorter_than_three_polls() -> None:
    time = WatchdogTime(None, 0.2)
    assert time.agreed_s == pytest.approx(0.6)
    time.measure(60.0)
    assert time.due_s() == MOST_S
    assert WatchdogTime(0.3, 0.05).due_s() is None


def test_the_time_of_a_starved_device_stands_still() -> None:
    clock = ManualClock()
    time = DeviceTime(clock.now, rate=2.0)
    for _ in range(10):
        clock.advance(0.01)
        now_s = time()
    assert now_s == pytest.approx(0.2)
    clock.advance(5.0)
    assert time() == pytest.approx(0.3)


def test_a_computer_that_was_held_up_does_not_blame_the_base() -> None:
    rig = Rig()
    rig.do("f0.1")
    rig.silence(1.0)
    assert rig.base.not_ready() is None
    with pytest.raises(NotReadyError, match=r"the base at memory was not polled for too long: its last reading is 1\."):
        rig.base.get_status()
    rig.wait(1.0)
    assert rig.base.get_status() is not None
    rig.do("f0.1")
    rig.port.is_cut = True
    rig.wait(1.0)
    assert "does not " in str(rig.base.not_ready())
