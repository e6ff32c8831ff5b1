"""plugins/evbot3: the driver against the emulator, over a network that loses, doubles and reorders datagrams."""

from __future__ import annotations

import math
from random import Random

import pytest

from eal_actors.kernel.errors import ArgumentError, UnavailableError
from eal_actors.plugin import EALData
from plugins.evbot2.messages import BaseRequest, State, Verb
from plugins.evbot2.serving import FaultyWire
from plugins.evbot2.wheels import WheelController
from plugins.evbot3.firmware import TurretController
from plugins.evbot3.protocol import base_codec, encode_request
from plugins.evbot3.sensors import Battery, Bump
from tests.unit.plugins.evbot3.rig import Rig3

STEP_M = 0.0002


class Logged:
    """The actions of a device's actuators in order: (verb, numbers)."""

    def __init__(self, rig: Rig3) -> None:
        self.orders: list[tuple[str, tuple[int, ...]]] = []
        for actuator in rig.device.firmware._actuators.values():
            assert isinstance(actuator, WheelController | TurretController)
            self._log(actuator)

    def _log(self, actuator: WheelController | TurretController) -> None:
        accept = actuator.accept

        def logged(verb: Verb, numbers: tuple[int, ...], tag: int, now_s: float) -> object:
            self.orders.append((verb.name, tuple(numbers)))
            return accept(verb, numbers, tag, now_s)

        actuator.accept = logged  # type: ignore[method-assign, assignment]

    def of(self, *verbs: str) -> list[tuple[str, tuple[int, ...]]]:
        return [order for order in self.orders if order[0] in verbs]


def test_it_drives_a_square_and_knows_where_it_is() -> None:
    rig = Rig3()
    rig.do(*["g", "r"] * 4, "s")
    assert rig.body.pose[:2] == pytest.approx((0.0, 0.0), abs=0.004)
    assert rig.odometer.pose[:2] == pytest.approx(rig.body.pose[:2], abs=0.002)


@pytest.mark.parametrize(
    ("commands", "yaw_deg"),
    [
        (["l90"], 90),
        (["r45"], -45),
        (["l350"], -10),
        (["t-170", "t170"], 170),
        (["l30", "t0"], 0),
        (["t-360"], 0),
        (["l3600"], 0),
        (["r0"], 0),
    ],
)
def test_the_turret_turns(commands: list[str], yaw_deg: float) -> None:
    rig = Rig3()
    rig.turn(*commands)
    rig.wait(0.1)
    value = rig.turret.get_value()
    assert value.value == pytest.approx(math.radians(yaw_deg), abs=1e-5)
    assert value.frame_id == "rob/base"
    assert rig.turret.get_status() == 0


def test_the_turret_goes_the_shorter_way_round() -> None:
    rig = Rig3()
    rig.turn("t-170")
    begun_s = rig.clock.now()
    rig.turn("t170")
    assert rig.clock.now() - begun_s < 0.5
    assert rig.body.turret is not None
    assert rig.body.turret.yaw_rad == pytest.approx(math.radians(-190), abs=1e-5)


def told_share(rig: Rig3) -> float:
    assert rig.turret._reported_progress is not None
    share, _ = rig.turret._reported_progress
    assert share is not None
    return share


@pytest.mark.parametrize(("command", "whole_deg"), [("l540", 540), ("r270", 270), ("t-90", 150)])
def test_the_turret_tells_how_far_it_has_come(command: str, whole_deg: float) -> None:
    rig = Rig3()
    rig.result(rig.start(rig.turret.send_cmd("t60")))
    swing, told = rig.start(rig.turret.send_cmd(command)), []
    for _ in range(12):
        rig.wait(0.1)
        told.append(told_share(rig))
    assert told == sorted(told)
    assert told[-1] == pytest.approx(90 * 1.2 / whole_deg, abs=0.1)  # at 90 degrees a second
    rig.result(swing)
    assert told_share(rig) == pytest.approx(1.0, abs=0.1)


def test_turret_and_wheels_do_not_disturb_each_other() -> None:
    rig = Rig3()
    drive = rig.start(rig.base.send_cmd("f0.5"), 0.2)
    swing = rig.start(rig.turret.send_cmd("l180"), 0.2)
    assert (rig.base.get_status(), rig.turret.get_status()) == (1, 1)
    rig.turret.send_cmd("s")
    with pytest.raises(UnavailableError, match="stop"):
        rig.result(swing)
    assert rig.result(drive) == 1
    assert rig.body.pose[0] == pytest.approx(0.5, abs=2 * STEP_M)
    assert rig.turret.get_status() == 0


def test_a_stopped_turret_stands_within_a_poll() -> None:
    rig = Rig3()
    rig.close(rig.start(rig.turret.send_cmd("l180"), 0.5))
    yaw_rad = rig.turret.get_value().value
    rig.wait(1.0)
    assert rig.turret.get_value().value == pytest.approx(yaw_rad, abs=math.radians(90) / 20 + 0.01)
    assert not rig.device.is_busy


@pytest.mark.parametrize("rate", [0.9, 180.1])
def test_a_rate_that_the_turret_does_not_reach_is_refused(rate: float) -> None:
    rig = Rig3()
    with pytest.raises(ArgumentError):
        rig.turret.set_config("turn_rate_deg_s", EALData.of(rate))


def test_after_a_silence_nothing_moves() -> None:
    rig = Rig3()
    rig.start(rig.base.send_cmd("f5"), 0.5)
    rig.start(rig.turret.send_cmd("l720"), 0.5)
    rig.silence(0.55)
    assert not rig.device.is_busy
    assert rig.body.turret is not None
    yaw_rad, pose = rig.body.turret.yaw_rad, rig.body.pose
    rig.silence(2.0)
    assert rig.body.turret.yaw_rad == yaw_rad
    assert rig.body.pose[0] == pytest.approx(pose[0], abs=0.05)
    rig.wait(1.0)  # the driver is back: it greets, and moves nothing
    assert rig.body.turret.yaw_rad == yaw_rad
    assert State(rig.session.latest().wheels.state) is State.SILENT


@pytest.mark.parametrize("seed", range(25))
def test_over_a_bad_network_no_order_is_carried_out_twice_or_out_of_order(seed: int) -> None:
    rig = Rig3()
    random = Random(seed)  # noqa: S311
    rig.port.there, rig.port.back = (FaultyWire(random, 0.08, 0.25, 0.1) for _ in range(2))
    logged = Logged(rig)
    for _ in range(4):
        rig.do("f0.1", "l90")
        rig.turn("l90")
    moves = [(100_000, 100_000), (-235_619, 235_619)] * 4
    assert [numbers[:2] for _, numbers in logged.of("MOVE")] == moves
    assert len(logged.of("SWING")) == 4
    assert rig.body.pose[:2] == pytest.approx((0.0, 0.0), abs=0.004)
    assert rig.turret.get_value().value == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("seed", range(20))
def test_over_the_worst_network_it_fails_safe(seed: int) -> None:
    rig = Rig3()
    random = Random(seed)  # noqa: S311
    rig.port.there, rig.port.back = (FaultyWire(random, 0.6, 0.4, 0.5) for _ in range(2))
    for text in ("f0.1", "l90", "b0.1", "r90"):
        logged = Logged(rig)
        try:
            rig.do(text)
        except UnavailableError:
            rig.wait(2.0)
            pose = rig.body.pose
            rig.wait(2.0)
            assert rig.body.pose == pose
        assert len(logged.of("MOVE")) <= 1


def test_what_was_held_back_for_long_moves_nothing() -> None:
    rig = Rig3()
    rig.start(rig.base.send_cmd("f0.1"), 0.0)
    old = bytes(rig.port.sent)
    rig.wait(5.0)
    rig.turn("l90")
    stands = rig.body.pose
    assert any(request.verb is Verb.MOVE for request in base_codec().feed(old) if isinstance(request, BaseRequest))
    rig.port.deliver(old)
    rig.wait(2.0)
    assert rig.body.pose == stands
    rig.silence(1.0)
    rig.port.deliver(old)
    rig.silence(2.0)
    assert rig.body.pose == stands


def test_an_order_to_a_turret_under_a_lapsed_lease_moves_nothing() -> None:
    rig = Rig3()
    rig.silence(1.0)
    rig.port.deliver(encode_request(BaseRequest(Verb.SWING, 2, 42, (1_000_000, 1_000_000))))
    rig.silence(1.0)
    assert rig.body.turret is not None
    assert rig.body.turret.yaw_rad == 0.0


@pytest.mark.parametrize("numbers", [(62_831_854 + 10, 1_000_000), (1000, 3_141_600), (1000, 0), (1000, -1_000_000)])
def test_the_firmware_refuses_what_the_turret_cannot_do(numbers: tuple[int, int]) -> None:
    rig = Rig3()
    order = rig.session.order(Verb.SWING, *numbers)
    with pytest.raises(Exception, match="refuses SWING: RANGE"):
        rig.run(order)


def test_bumpers_and_battery() -> None:
    rig = Rig3()
    bump, battery = Bump(rig.session), Battery(rig.session)
    assert not bump.get_value().value
    rig.body.bumped = (True, False)
    rig.wait(0.1)
    assert [bump.get_value().value, bump.left().value, bump.right().value] == [True, True, False]
    rig.body.bumped = (False, True)
    rig.wait(0.1)
    assert [bump.get_value().value, bump.left().value, bump.right().value] == [True, False, True]
    assert battery.get_value().value == pytest.approx(6.5 / 7.2)
    figures = [battery.voltage(), battery.current(), battery.charge(), battery.capacity(), battery.temperature()]
    assert [figure.value for figure in figures] == [12.6, -1.5, 6.5, 7.2, 23.5]
