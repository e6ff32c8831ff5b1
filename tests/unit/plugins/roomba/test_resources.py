"""plugins/roomba: the sensors answer from the latest reading, or not at all."""

from __future__ import annotations

import math
from typing import Any

import pytest

from eal_actors.kernel.errors import ArgumentError, UnavailableError
from eal_actors.plugin import EALData, Resource
from plugins.roomba import panel, resources
from plugins.roomba.bodies import ConstantBattery
from plugins.roomba.odometry import DeadReckoning
from tests.unit.plugins.roomba.rig import Rig

KINDS = {
    kind.__name__: kind
    for kind in (
        resources.RoombaBump,
        resources.RoombaCliff,
        resources.SciWheelDrop,
        resources.RoombaWall,
        resources.RoombaBattery,
        resources.RoombaOdometry,
        panel.SciButtons,
    )
}


def sensor(rig: Rig, name: str) -> Resource:
    return KINDS[name](rig.roomba)


def answers(rig: Rig, name: str) -> dict[str, Any]:
    """Return the answer to get_value under "", and to each request under its name."""
    resource = sensor(rig, name)
    found = {"": resource.get_value().value}
    return found | {request.name: resource.send_req(request.name).value for request in resource.info().requests}


CASES: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "nothing touched": ("RoombaBump", {}, {"": False, "left": False, "right": False}),
    "left bumper": ("RoombaBump", {"bumped": (True, False)}, {"": True, "left": True, "right": False}),
    "right bumper": ("RoombaBump", {"bumped": (False, True)}, {"": True, "left": False, "right": True}),
    "cliff left": (
        "RoombaCliff",
        {"over_cliffs": (True, False, False, False)},
        {"": True, "left": True, "front_left": False, "front_right": False, "right": False},
    ),
    "cliff front right": (
        "RoombaCliff",
        {"over_cliffs": (False, False, True, False)},
        {"": True, "left": False, "front_left": False, "front_right": True, "right": False},
    ),
    "left wheel": (
        "SciWheelDrop",
        {"dropped": (True, False, False)},
        {"": True, "left": True, "right": False, "caster": False},
    ),
    "caster": (
        "SciWheelDrop",
        {"dropped": (False, False, True)},
        {"": True, "left": False, "right": False, "caster": True},
    ),
    "a wall": ("RoombaWall", {"by_wall": True}, {"": True, "virtual": False}),
    "half full": (
        "RoombaBattery",
        {},
        {"": 0.5, "voltage": 16.1, "current": -0.3, "charge": 1.35, "capacity": 2.7, "temperature": 24.0},
    ),
    "over full": (
        "RoombaBattery",
        {"charge": ConstantBattery(17.0, 0.5, 2.8, 2.7, -5.0)},
        {"": 1.0, "voltage": 17.0, "current": 0.5, "charge": 2.8, "capacity": 2.7, "temperature": -5.0},
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_the_body_feels_is_answered(case: str) -> None:
    name, feelings, expected = CASES[case]
    rig = Rig()
    for feeling, value in feelings.items():
        setattr(rig.body, feeling, value)
    rig.wait(0.1)
    assert answers(rig, name) == pytest.approx(expected)


@pytest.mark.parametrize("button", ["max", "clean", "spot", "power"])
def test_buttons(button: str) -> None:
    rig = Rig()
    rig.emulator.pressed = frozenset({button})
    rig.wait(0.1)
    names = ["max", "clean", "spot", "power"]
    assert answers(rig, "SciButtons") == {"": True} | {name: name == button for name in names}


@pytest.mark.parametrize("name", KINDS)
def test_no_sensor_answers_from_an_old_reading(name: str) -> None:
    rig = Rig()
    rig.port.is_cut = True
    rig.wait(0.5)
    resource = sensor(rig, name)
    with pytest.raises(UnavailableError, match="does not answer"):
        resource.get_value()
    for request in resource.info().requests:
        with pytest.raises(UnavailableError, match="does not answer"):
            resource.send_req(request.name)


def test_answers_bear_the_time_of_their_reading() -> None:
    rig = Rig()
    rig.wait(0.12)
    for name in KINDS:
        assert sensor(rig, name).get_value().stamp_s == rig.roomba.latest().stamp_s
    assert rig.roomba.latest().stamp_s < rig.clock.now()


def test_odometry_follows_the_wheels() -> None:
    rig = Rig()
    rig.do("f0.5", "l90", "f0.25")
    odometry = sensor(rig, "RoombaOdometry")
    pose = odometry.get_value()
    assert pose.frame_id == "rob/odom"
    assert pose.value == pytest.approx([0.5, 0.25, math.pi / 2], abs=0.02)
    travel = odometry.send_req("travel")
    assert travel.unit == "m"
    assert travel.value == pytest.approx(list(rig.body.travel_m()), abs=0.0021)


def test_odometry_can_be_told_where_it_is() -> None:
    rig = Rig()
    rig.do("f0.2")
    odometry = sensor(rig, "RoombaOdometry")
    before = odometry.send_req("travel").value
    odometry.set_value(EALData.of([1, 2, -3]))
    assert odometry.get_value().value == pytest.approx([1.0, 2.0, -3.0])
    assert odometry.send_req("travel").value == before
    rig.do("f1")
    assert odometry.get_value().value == pytest.approx([1 + math.cos(3), 2 - math.sin(3), -3.0], abs=0.005)


@pytest.mark.parametrize("pose", [[math.nan, 0.0, 0.0], [0.0, math.inf, 0.0]])
def test_odometry_refuses_a_place_that_is_none(pose: list[float]) -> None:
    with pytest.raises(ArgumentError, match="must consist of finite numbers"):
        sensor(Rig(), "RoombaOdometry").set_value(EALData.of(pose))


def test_dead_reckoning_of_an_arc_is_exact_in_one_step() -> None:
    reckoning = DeadReckoning(0.258)
    radius_m = 0.5
    reckoning.add((radius_m - 0.129) * math.pi / 2, (radius_m + 0.129) * math.pi / 2)
    assert reckoning.pose == pytest.approx((radius_m, radius_m, math.pi / 2))


def test_dead_reckoning_keeps_its_yaw_within_a_turn() -> None:
    reckoning = DeadReckoning(0.258)
    for _ in range(4):
        reckoning.add(-0.129 * math.pi * 0.75, 0.129 * math.pi * 0.75)
        assert -math.pi < reckoning.pose[2] <= math.pi
    assert reckoning.pose == pytest.approx((0.0, 0.0, math.pi))
