"""plugins/roomba: the base drives by the encoders, and stops where it must."""

from __future__ import annotations

import math

import pytest

from eal_actors.kernel.errors import ArgumentError, ResourceFaultError, UnavailableError
from eal_actors.plugin import EALData
from plugins.roomba.sci import CLOCKWISE, COUNTER_CLOCKWISE, STRAIGHT, Mode
from plugins.roomba.sci_driver import twist_drive
from tests.unit.plugins.roomba.rig import Rig, without_polls

STOP = bytes([137, 0, 0, 0, 1])


def travel_m(rig: Rig) -> tuple[float, float]:
    return rig.body.travel_m()


def yaw_deg(rig: Rig) -> float:
    left_m, right_m = travel_m(rig)
    return math.degrees((right_m - left_m) / 0.258)


@pytest.mark.parametrize("poll_hz", [5, 20, 50])
@pytest.mark.parametrize(
    ("text", "expected_m"), [("g", 0.5), ("b", -0.5), ("f1.25", 1.25), ("b0.07", -0.07), ("f0.01", 0.01), ("f0", 0.0)]
)
def test_distances(text: str, expected_m: float, poll_hz: float) -> None:
    rig = Rig(poll_hz=poll_hz)
    rig.do(text)
    assert travel_m(rig) == pytest.approx((expected_m, expected_m), abs=0.003)
    assert (rig.emulator.violations, rig.emulator.refused) == (0, 0)


@pytest.mark.parametrize("poll_hz", [5, 20, 50])
@pytest.mark.parametrize(
    ("text", "expected_deg"), [("l", 90), ("r", -90), ("l45", 45), ("r5", -5), ("l360", 360), ("r0", 0)]
)
def test_turns(text: str, expected_deg: float, poll_hz: float) -> None:
    rig = Rig(poll_hz=poll_hz)
    rig.do(text)
    left_m, right_m = travel_m(rig)
    assert yaw_deg(rig) == pytest.approx(expected_deg, abs=1.0)
    assert left_m == pytest.approx(-right_m)


def test_errors_do_not_pile_up_over_a_square_there_and_back() -> None:
    rig = Rig()
    rig.do(*["g", "r"] * 4, "s", *["l", "b"] * 4, "s")  # the drive test of the thesis
    assert travel_m(rig) == pytest.approx((0.0, 0.0), abs=0.02)


def test_it_cruises_at_the_speed_that_was_set_and_slows_down_before_the_end() -> None:
    rig = Rig()
    rig.base.set_config("speed_m_s", EALData.of(0.4))
    drive = rig.begin("f2", 2.0)
    assert (rig.body.left.speed_m_s, rig.base.get_status()) == (0.4, 1)
    rig.take_sent()
    rig.run(drive)
    sent = without_polls(rig.take_sent())
    speeds = [int.from_bytes(sent[at + 1 : at + 3], "big") for at in range(0, len(sent), 5)]
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[-1] == 0
    assert 20 <= min(speed for speed in speeds if speed) < 60
    assert rig.base.get_status() == 0


def test_it_turns_at_the_rate_that_was_set() -> None:
    rig = Rig()
    rig.base.set_config("turn_rate_deg_s", EALData.of(45.0))
    _turn = rig.begin("l360", 2.0)
    assert rig.body.right.speed_m_s == pytest.approx(math.radians(45) * 0.129, abs=0.0005)


def test_after_its_time_the_robot_stands() -> None:
    rig = Rig()
    rig.do("f0.3")
    assert rig.body.left.speed_m_s == 0.0
    assert rig.roomba.latest().stands


def test_a_command_in_place_of_another_begins_from_rest() -> None:
    rig = Rig()
    first = rig.begin("f5", 1.5)
    first.close()
    assert rig.body.left.target_m_s == 0.0
    before_m, _ = travel_m(rig)
    rig.wait(0.0)
    rig.do("l90")
    assert yaw_deg(rig) == pytest.approx(90, abs=1.0)
    rested_m = sum(travel_m(rig)) / 2
    assert 0.0 < rested_m - before_m < 0.08  # it rolled out, and that is not part of the turn
    rig.do("f0.5")
    assert sum(travel_m(rig)) / 2 - rested_m == pytest.approx(0.5, abs=0.003)


def test_closing_a_motion_and_a_halt_each_send_drive_0() -> None:
    rig = Rig()
    drive = rig.begin("f5", 0.5)
    rig.take_sent()
    drive.close()
    assert rig.take_sent() == STOP
    rig.base.halt()
    rig.base.halt()
    assert rig.take_sent() == STOP * 2


@pytest.mark.parametrize("mode", [Mode.SAFE, Mode.FULL])
def test_a_cliff_halts_the_way_forward_but_not_the_way_back(mode: Mode) -> None:
    rig = Rig(mode)
    drive = rig.begin("f5", 1.0)
    rig.body.over_cliffs = (False, True, False, True)
    with pytest.raises(ResourceFaultError, match=r"^halted: cliff \(front left, right\)$"):
        rig.run(drive)
    assert rig.body.left.target_m_s == 0.0
    rig.wait(1.0)
    with pytest.raises(ResourceFaultError, match="cliff"):
        rig.run(rig.base.send_cmd("f0.1"))
    before_m, _ = travel_m(rig)
    rig.do("b0.1")
    assert travel_m(rig)[0] - before_m == pytest.approx(-0.1, abs=0.003)
    rig.do("l90")
    rig.body.over_cliffs = (False,) * 4
    rig.wait(0.1)
    rig.do("f0.1")
    assert (rig.emulator.mode, rig.emulator.violations) == (mode, 0)


@pytest.mark.parametrize("mode", [Mode.SAFE, Mode.FULL])
@pytest.mark.parametrize("text", ["f5", "b5", "l360"])
def test_a_wheel_drop_halts_everything(mode: Mode, text: str) -> None:
    rig = Rig(mode)
    activity = rig.begin(text, 1.0)
    rig.body.dropped = (True, False, True)
    with pytest.raises(ResourceFaultError, match=r"^halted: wheel drop \(left wheel, caster\)$"):
        rig.run(activity)
    assert rig.body.right.target_m_s == 0.0
    rig.body.dropped = (False,) * 3
    rig.wait(1.0)
    rig.do("f0.1")
    assert rig.emulator.mode is mode


def test_a_silent_robot_ends_the_motion() -> None:
    rig = Rig()
    drive = rig.begin("f5", 1.0)
    rig.port.is_cut = True
    rig.take_sent()
    with pytest.raises(UnavailableError, match="does not answer"):
        rig.run(drive)
    assert rig.take_sent().endswith(STOP)
    with pytest.raises(UnavailableError, match="does not answer"):
        rig.run(rig.base.send_cmd("g"))


def test_wheels_that_do_not_turn_are_a_fault_and_the_next_command_takes_control_anew() -> None:
    rig = Rig()
    drive = rig.begin("f1", 0.2)
    rig.emulator.mode = Mode.PASSIVE  # somebody pressed a button
    rig.body.is_stuck = True
    with pytest.raises(ResourceFaultError, match=r"driven at 300 mm/s, the wheels counted nothing in 2 s"):
        rig.run(drive)
    rig.body.is_stuck = False
    rig.do("f0.1")
    assert rig.emulator.mode is Mode.SAFE


def test_the_slowest_motions_are_no_stall() -> None:
    rig = Rig(poll_hz=50)
    rig.base.set_config("turn_rate_deg_s", EALData.of(1.0))
    rig.base.set_config("speed_m_s", EALData.of(0.01))
    rig.do("l5", "f0.02")
    assert yaw_deg(rig) == pytest.approx(5, abs=1.0)


@pytest.mark.parametrize("bumped", [(True, False), (False, True)])
def test_a_bump_on_the_way_is_told_by_the_status(bumped: tuple[bool, bool]) -> None:
    rig = Rig()
    rig.body.bumped = bumped
    rig.wait(0.1)
    assert rig.base.get_status() == 0
    _drive = rig.begin("f5", 0.5)
    assert rig.base.get_status() == 2


# Twists.


@pytest.mark.parametrize(
    ("twist", "expected"),
    [
        ((0.2, 0.0), (200, STRAIGHT)),
        ((-0.2, 0.0), (-200, STRAIGHT)),
        ((0.0, 1.0), (129, COUNTER_CLOCKWISE)),
        ((0.0, -1.0), (129, CLOCKWISE)),
        ((0.2, 0.4), (200, 500)),
        ((0.2, -0.4), (200, -500)),
        ((-0.2, -0.4), (-200, 500)),  # the document's example: backwards, the turning point to the left
        ((0.3, 0.1), (300, 2000)),  # 3 m: nearer to 2 m than to straight
        ((0.3, 0.07), (300, STRAIGHT)),  # 4.3 m: nearer to straight
        ((0.001, 1.0), (129, COUNTER_CLOCKWISE)),  # 1 mm would mean in place anyway
        ((0.0, 0.0), (0, CLOCKWISE)),
    ],
)
def test_twists_on_the_wire(twist: tuple[float, float], expected: tuple[int, int]) -> None:
    assert twist_drive(*twist) == expected


@pytest.mark.parametrize(
    ("twist", "expected"),
    [
        ((0.5, 0.5), (443, 1000)),  # the outer wheel would have to run 564.5 mm/s: the same curve at 500 / 564.5
        ((-0.5, 0.5), (-443, -1000)),
        ((0.5, math.pi), (276, 159)),
        ((0.0, math.pi), (405, COUNTER_CLOCKWISE)),
    ],
)
def test_a_curve_too_fast_for_a_wheel_is_driven_slower(twist: tuple[float, float], expected: tuple[int, int]) -> None:
    assert twist_drive(*twist) == expected


@pytest.mark.parametrize(
    ("twist", "words"),
    [
        ((0.51, 0.0), r"the twist's speed must be -0\.5\.\.0\.5 m/s, which the roomba reaches, not 0\.51"),
        ((-0.51, 0.0), "speed"),
        ((math.nan, 0.0), "speed"),
        ((0.0, 3.2), r"turn rate must be -3\.142\.\.3\.142 rad/s"),
        ((0.0, math.inf), "turn rate"),
    ],
)
def test_twists_beyond_its_reach_are_refused(twist: tuple[float, float], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        Rig().base.set_value(EALData.of(list(twist)))


def test_a_twist_lasts_until_its_time_is_over() -> None:
    rig = Rig()
    twist = rig.base.set_value(EALData.of([0.2, 0.4]))
    rig.start(twist, 0.45)
    assert (rig.body.left.target_m_s, rig.body.right.target_m_s) == pytest.approx((0.1484, 0.2516))
    assert rig.base.get_status() == 1
    began_s = rig.clock.now() - 0.45
    rig.run(twist)
    assert rig.clock.now() - began_s == pytest.approx(0.5, abs=0.005)
    assert (rig.base.get_status(), rig.body.right.target_m_s) == (0, 0.0)


def test_renewed_twists_go_on_without_a_stop_between_and_the_last_one_ends() -> None:
    rig = Rig()
    rig.base.set_config("twist_timeout_s", EALData.of(0.3))
    rig.take_sent()
    for _ in range(10):
        twist = rig.base.set_value(EALData.of([0.1, 0.0]))
        rig.start(twist, 0.2)
        twist.close()
    assert without_polls(rig.take_sent()) == bytes([137, 0, 100, 128, 0]) * 10
    assert rig.base.get_status() == 1
    rig.wait(0.11)
    assert without_polls(rig.take_sent()) == STOP
    assert rig.base.get_status() == 0


def test_a_command_takes_over_from_a_twist() -> None:
    rig = Rig()
    twist = rig.base.set_value(EALData.of([0.3, 0.0]))
    rig.start(twist, 0.4)
    twist.close()
    rig.do("l90")
    assert yaw_deg(rig) == pytest.approx(90, abs=1.0)
    twist = rig.base.set_value(EALData.of([0.3, 0.0]))
    rig.start(twist, 0.1)
    twist.close()
    rig.base.send_cmd("s")
    assert rig.base.get_status() == 0
    assert rig.body.left.target_m_s == 0.0


def test_a_twist_forward_over_a_cliff_is_a_fault() -> None:
    rig = Rig(Mode.FULL)
    twist = rig.base.set_value(EALData.of([0.1, 0.0]))
    rig.start(twist, 0.1)
    rig.body.over_cliffs = (True, False, False, False)
    with pytest.raises(ResourceFaultError, match=r"cliff \(left\)"):
        rig.run(twist)
    rig.wait(0.01)
    assert (rig.base.get_status(), rig.body.left.target_m_s) == (0, 0.0)
    with pytest.raises(ResourceFaultError, match=r"cliff \(left\)"):
        rig.run(rig.base.set_value(EALData.of([0.1, 0.0])))
    back = rig.base.set_value(EALData.of([-0.1, 0.0]))
    rig.start(back, 0.1)
    assert rig.body.left.target_m_s == -0.1


@pytest.mark.parametrize("what", ["cliff", "silence"])
def test_a_twist_nobody_waits_for_is_halted_too(what: str) -> None:
    rig = Rig(Mode.FULL)
    rig.base.set_config("twist_timeout_s", EALData.of(10.0))
    twist = rig.base.set_value(EALData.of([0.1, 0.0]))
    rig.start(twist, 0.1)
    twist.close()
    rig.take_sent()
    if what == "cliff":
        rig.body.over_cliffs = (False, False, False, True)
    else:
        rig.port.is_cut = True
    rig.wait(0.6)
    sent = without_polls(rig.take_sent())
    assert sent.endswith(STOP)  # repeated until it is seen to stand; before, the twist may have been repeated
    assert rig.base.get_status() == 0
