"""plugins/evbot2: the driver against the emulator, over a wire on which everything can go wrong."""

from __future__ import annotations

import binascii
import math
from random import Random
from typing import Any

import pytest

from eal_actors.kernel.errors import ArgumentError, NotReadyError, ResourceFaultError, UnavailableError
from eal_actors.plugin import EALData
from plugins.evbot2.emulator import evbot2
from plugins.evbot2.messages import BaseRequest, Code, State, Verb
from plugins.evbot2.odometry import Odometry
from plugins.evbot2.protocol import encode_request
from plugins.evbot2.serving import FaultyWire
from plugins.roomba.odometry import DeadReckoning
from tests.unit.plugins.evbot2.rig import STEP_M, TICK_S, Rig, sent_verbs


@pytest.mark.parametrize(
    ("command", "pose"),
    [
        ("g", (0.5, 0.0, 0.0)),
        ("b", (-0.5, 0.0, 0.0)),
        ("f1.2", (1.2, 0.0, 0.0)),
        ("b0.05", (-0.05, 0.0, 0.0)),
        ("l", (0.0, 0.0, math.pi / 2)),
        ("r", (0.0, 0.0, -math.pi / 2)),
        ("l90", (0.0, 0.0, math.pi / 2)),
        ("r45", (0.0, 0.0, -math.pi / 4)),
        ("l720", (0.0, 0.0, 4 * math.pi)),
        ("f0", (0.0, 0.0, 0.0)),
        ("r0", (0.0, 0.0, 0.0)),
    ],
)
def test_a_command_goes_where_it_should_within_the_encoders_resolution(
    command: str, pose: tuple[float, float, float]
) -> None:
    rig = Rig()
    rig.do(command)
    assert rig.body.pose[:2] == pytest.approx(pose[:2], abs=2 * STEP_M)
    left_m, right_m = rig.body.travel_m()
    assert (right_m - left_m) / 0.24 == pytest.approx(pose[2], abs=2 * STEP_M / 0.24)
    assert rig.base.get_status() == 0


@pytest.mark.parametrize(("command", "way_m"), [("f1", (1.0, 1.0)), ("b1", (-1.0, -1.0)), ("r180", (0.377, -0.377))])
def test_a_motion_tells_how_far_it_has_come(command: str, way_m: tuple[float, float]) -> None:
    rig = Rig()
    rig.do("f0.2", "l30")  # after which the encoders are anywhere
    start_m = rig.body.travel_m()
    motion, told = rig.start(rig.base.send_cmd(command)), []
    for _ in range(12):
        rig.wait(0.1)
        assert rig.base._reported_progress is not None
        fraction, _text = rig.base._reported_progress
        gone = [(now - then) / way for now, then, way in zip(rig.body.travel_m(), start_m, way_m, strict=True)]
        assert fraction == pytest.approx(sum(gone) / 2, abs=0.06)  # of a moment ago
        told.append(fraction)
    assert told == sorted(told)
    assert 0.1 < told[-1] < 0.9
    rig.result(motion)
    assert rig.base._reported_progress[0] == pytest.approx(1.0, abs=0.06)


def test_the_thesis_square_ends_where_it_began() -> None:
    rig = Rig()
    rig.do(*["g", "r"] * 4, "s", *["l", "b"] * 4, "s")
    assert rig.body.pose == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    seen = Odometry(rig.session, rig.odometer).get_value()
    assert seen.value == pytest.approx(rig.body.pose, abs=0.006)
    assert seen.frame_id == "rob/odom"


def test_a_known_track_factor_makes_up_for_skidding() -> None:
    rig = Rig(calibration={"track_factor": 1.2})
    rig.body._odometer = DeadReckoning(0.24 * 1.2)
    rig.do("l90")
    assert rig.body.pose[2] == pytest.approx(math.pi / 2, abs=0.006)
    assert Odometry(rig.session, rig.odometer).get_value().value[2] == pytest.approx(math.pi / 2, abs=0.006)
    rig.base.set_config("track_factor", EALData.of(1.0))
    rig.do("l90")
    assert rig.body.pose[2] == pytest.approx(math.pi / 2 * (1 + 1 / 1.2), abs=0.01)  # 165 degrees


def test_a_twist_ends_after_its_time_and_a_newer_one_takes_over_without_a_stop() -> None:
    rig = Rig()
    first = rig.start(rig.base.set_value(EALData.of([0.2, 0.0])), 0.3)
    assert rig.base.get_status() == 1
    rig.close(first)
    sent_verbs(rig)
    rig.run(rig.base.set_value(EALData.of([0.2, 0.5])))
    assert "STOP" not in sent_verbs(rig)
    rig.wait(0.3)
    assert rig.base.get_status() == 0
    assert rig.stands_for(1.0)
    assert rig.body.pose[2] > 0.1


def test_a_twist_too_fast_for_a_wheel_is_the_same_curve_slower() -> None:
    rig = Rig()
    rig.base.set_config("twist_timeout_s", EALData.of(20.0))
    rig.run(rig.base.set_value(EALData.of([0.4, 2.0])))
    left_m, right_m = rig.body.travel_m()
    assert left_m / right_m == pytest.approx((0.4 - 0.24) / (0.4 + 0.24), abs=0.02)


@pytest.mark.parametrize("how", ["close", "s", "halt"])
def test_a_stop_holds_within_a_poll(how: str) -> None:
    rig = Rig()
    motion = rig.start(rig.base.send_cmd("f5"), 1.5)
    if how == "close":
        rig.close(motion)
    elif how == "s":
        assert rig.base.send_cmd("s") == 1
    else:
        rig.base.halt()
    x_m = rig.body.pose[0]
    rig.wait(1 / 20)
    assert not rig.device.is_busy
    assert rig.stands_for(2.0) or rig.body.pose[0] - x_m < 0.02


def test_a_stuck_wheel_is_told_and_nothing_is_driven_any_more() -> None:
    rig = Rig()
    rig.body.is_stuck = True
    motion = rig.start(rig.base.send_cmd("g"), 0.5)
    assert rig.base.get_status() == 2
    with pytest.raises(ResourceFaultError, match=r"halted: it was driven, but its encoders counted nothing in 1.5 s"):
        rig.result(motion)
    assert not rig.device.is_busy


# The wire.


def test_lost_acknowledgements_never_make_it_go_twice() -> None:
    rig = Rig()
    rig.port.is_deaf = True
    motion = rig.start(rig.base.send_cmd("f0.1"), 0.2)
    rig.port.is_deaf = False
    assert rig.result(motion) == 1
    verbs = sent_verbs(rig)
    assert verbs.count("MOVE") > 1
    assert rig.body.pose[0] == pytest.approx(0.1, abs=2 * STEP_M)


@pytest.mark.parametrize("seed", range(20))
def test_over_a_wire_that_loses_and_doubles_each_order_is_carried_out_once(seed: int) -> None:
    rig = Rig()
    random = Random(seed)  # noqa: S311
    rig.port.there, rig.port.back = (FaultyWire(random, loss=0.15, duplicate=0.2) for _ in range(2))
    for _ in range(4):
        rig.do("f0.1", "l90")
    assert rig.body.pose[:2] == pytest.approx((0.0, 0.0), abs=0.006)
    assert rig.body.pose[2] == pytest.approx(0.0, abs=0.02)
    assert rig.device.firmware.executed == 8 + 1  # and the stop of the greeting


def test_a_stop_whose_acknowledgement_is_lost_is_sent_again_and_nothing_else_keeps_the_base_awake() -> None:
    rig = Rig()
    motion = rig.start(rig.base.send_cmd("f5"), 1.0)
    rig.port.is_cut = True
    rig.close(motion)
    sent_verbs(rig)
    rig.wait(0.3)
    assert set(sent_verbs(rig)) == {"STOP"}
    rig.port.is_cut = False
    rig.wait(0.25)
    assert not rig.device.is_busy
    assert "STAT" in sent_verbs(rig)


def test_an_order_that_is_not_acknowledged_fails_and_nothing_moves_after() -> None:
    rig = Rig()
    rig.port.is_cut = True
    motion = rig.start(rig.base.send_cmd("f5"))
    with pytest.raises(UnavailableError, match="the base at memory does not acknowledge MOVE, sent 8 times"):
        rig.result(motion)
    rig.port.is_cut = False
    assert rig.stands_for(3.0)
    rig.do("f0.1")


@pytest.mark.parametrize("watchdog_s", [0.5, 2.0])
def test_a_base_whose_answers_are_lost_is_stopped_when_its_driver_gives_up(watchdog_s: float) -> None:
    rig = Rig(watchdog_s=watchdog_s)
    rig.do("f0.1")
    rig.port.is_deaf = True
    motion = rig.start(rig.base.send_cmd("f5"))
    with pytest.raises(UnavailableError, match="the base at memory does not acknowledge MOVE, sent 8 times"):
        rig.result(motion)
    rig.wait(0.4)  # it brakes
    assert rig.stands_for(0.2)
    rig.port.is_deaf = False
    assert rig.stands_for(1.0)
    rig.do("b0.1")


def test_a_stop_of_a_lost_base_is_repeated_while_it_is_greeted() -> None:
    rig = Rig(watchdog_s=2.0)
    rig.do("f0.1")
    rig.port.is_deaf = True
    motion = rig.start(rig.base.send_cmd("f5"), 1.0)
    rig.port.is_cut = True
    with pytest.raises(UnavailableError):
        rig.result(motion)
    rig.port.is_cut = False
    rig.wait(0.6)
    assert rig.stands_for(0.2)


def test_a_frozen_base_is_named_and_stands_when_it_wakes() -> None:
    rig = Rig()
    motion = rig.start(rig.base.send_cmd("f5"), 1.0)
    rig.port.is_cut = True
    with pytest.raises(
        UnavailableError, match=r"the base at memory does not answer: its last reading is 0\.\d\d s old"
    ):
        rig.result(motion)
    rig.wait(1.0)
    with pytest.raises(NotReadyError, match="the base at memory"):
        rig.base.get_status()
    assert rig.base.not_ready() is not None
    assert not rig.device.is_busy
    rig.port.is_cut = False
    assert rig.stands_for(2.0)
    assert rig.base.not_ready() is None
    rig.do("b0.1")


def test_a_driver_that_falls_silent_leaves_a_base_that_stands() -> None:
    rig = Rig(watchdog_s=0.3)
    motion = rig.start(rig.base.send_cmd("f5"), 1.0)
    rig.silence(0.35)
    assert not rig.device.is_busy
    rig.silence(5.0)
    with pytest.raises(UnavailableError, match="the base"):
        rig.result(motion)
    assert rig.stands_for(2.0)
    rig.do("f0.1")


def test_a_port_that_is_lost_in_the_middle_of_a_line_comes_back() -> None:
    rig = Rig()
    rig.do("f0.1")
    motion = rig.start(rig.base.send_cmd("f5"), 1.0)
    rig.port.arrive(b"$12 STAT OK 15")
    rig.is_there = False
    rig.port.is_broken = True
    with pytest.raises(UnavailableError, match="memory was lost: input/output error"):
        rig.result(motion)
    rig.silence(0.6)
    assert not rig.device.is_busy
    rig.wait(0.3)
    assert "memory" in str(rig.base.not_ready())
    with pytest.raises(UnavailableError):
        rig.run(rig.base.send_cmd("g"))
    rig.come_back()
    assert rig.stands_for(1.0)
    assert rig.base.not_ready() is None
    x_m = rig.body.pose[0]
    rig.do("f0.1")
    assert rig.body.pose[0] == pytest.approx(x_m + 0.1, abs=2 * STEP_M)
    assert Odometry(rig.session, rig.odometer).get_value().value[0] == pytest.approx(rig.body.pose[0], abs=2 * STEP_M)


def test_a_device_that_is_absent_at_first_is_greeted_when_it_comes() -> None:
    rig = Rig(is_there=False)
    rig.wait(1.0)
    assert "cannot open memory: no such file or directory" in str(rig.base.not_ready())
    with pytest.raises(NotReadyError, match="cannot open memory"):
        rig.base.get_status()
    rig.base.halt()  # it was never there: nothing moves
    rig.come_back()
    rig.wait(0.5)
    assert rig.base.not_ready() is None
    rig.do("g")


def test_a_base_that_was_switched_off_and_on_goes_on_from_where_it_was() -> None:
    rig = Rig()
    rig.do("f0.3")
    rig.switch_off_and_on()
    rig.wait(0.5)
    assert Odometry(rig.session, rig.odometer).get_value().value[0] == pytest.approx(0.3, abs=2 * STEP_M)
    rig.do("f0.2")
    odometry = Odometry(rig.session, rig.odometer)
    assert odometry.get_value().value[0] == pytest.approx(0.5, abs=3 * STEP_M)
    assert odometry.travel().value == pytest.approx([0.5, 0.5], abs=3 * STEP_M)


def test_a_base_that_is_switched_off_in_a_motion_is_told() -> None:
    rig = Rig()
    motion = rig.start(rig.base.send_cmd("f5"), 1.0)
    rig.switch_off_and_on()
    with pytest.raises(UnavailableError, match="the base at memory"):
        rig.result(motion)
    assert rig.stands_for(2.0)


def test_noise_on_the_line_disturbs_nothing() -> None:
    rig = Rig()
    motion = rig.start(rig.base.send_cmd("g"))
    random = Random(5)  # noqa: S311
    for _ in range(20):
        rig.port.arrive(random.randbytes(random.randrange(60)))
        rig.wait(0.05)
    assert rig.result(motion) == 1
    assert rig.body.pose[0] == pytest.approx(0.5, abs=2 * STEP_M)


def test_an_old_status_that_comes_late_is_not_believed() -> None:
    rig = Rig()
    rig.do("f0.1")
    newest = rig.session.latest()
    session = rig.session._lease
    assert session is not None
    session.sent_s[9999] = 0.0
    rig.port.arrive(b"$9999 STAT OK 1 0 0 0 0 0*%04X\n" % binascii.crc_hqx(b"9999 STAT OK 1 0 0 0 0 0", 0))
    rig.session._receive()
    assert rig.session.latest() is newest


def test_what_the_base_refuses_is_told_by_its_code() -> None:
    rig = Rig()
    order = rig.session.order(Verb.MOVE, 1, 1, 999_999_999)
    with pytest.raises(ResourceFaultError, match="the base at memory refuses MOVE: RANGE"):
        rig.run(order)


def test_another_host_that_drives_it_is_waited_for() -> None:
    rig = Rig(is_there=False)
    firmware = rig.device.firmware
    assert firmware.handle(BaseRequest(Verb.HELLO, 1, 0, (1, 500, 5)), 0.0).code is Code.OK
    rig.come_back()
    rig.wait(0.3)
    assert rig.base.not_ready() == "the base at memory is used by another host until that one is silent"
    rig.wait(1.0)
    assert rig.base.not_ready() is None


def test_another_model_is_told() -> None:
    class Other(Rig):
        def make_device(self) -> Any:
            device = evbot2(self.body, TICK_S)
            device.firmware._model = 3
            return device

    rig = Other()
    rig.wait(0.5)
    assert rig.base.not_ready() == "the base at memory is an EvBot 3, not an EvBot 2"


def test_stray_orders_of_an_earlier_life_move_nothing() -> None:
    rig = Rig()
    rig.do("f0.1")
    lease = rig.session._lease.welcome.lease if rig.session._lease else 0
    for tag, old in ((1, lease), (2, lease), (40_000, lease), (9, lease - 1), (9, lease + 1), (9, 0)):
        rig.port.deliver(encode_request(BaseRequest(Verb.MOVE, tag, old, (500_000, 500_000, 200_000))))
    assert rig.stands_for(2.0)
    assert State(rig.session.latest().wheels.state) is State.DONE


def test_placing_the_odometry() -> None:
    rig = Rig()
    odometry = Odometry(rig.session, rig.odometer)
    odometry.set_value(EALData.of([1.0, 2.0, math.pi / 2]))
    rig.do("f0.5")
    assert odometry.get_value().value == pytest.approx([1.0, 2.5, math.pi / 2], abs=2 * STEP_M)
    with pytest.raises(ArgumentError, match="finite numbers"):
        odometry.set_value(EALData.of([1.0, math.nan, 0.0]))
