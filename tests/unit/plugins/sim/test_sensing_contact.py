"""Bump, cliff, wheel drop and wall: each sensor where it sits."""

from __future__ import annotations

import math

import pytest

from plugins.sim.models import MakeName
from plugins.sim.resources.sensing import Bump, Cliff, Wall, WheelDrop
from tests.unit.plugins.sim.sensing import Stage, room

HALF_M = 0.02  # of a drop under one sensor alone


def polar(distance_m: float, bearing_deg: float) -> tuple[float, float]:
    return distance_m * math.cos(math.radians(bearing_deg)), distance_m * math.sin(math.radians(bearing_deg))


def drop_at(x_m: float, y_m: float) -> dict[str, object]:
    return {"x_m": x_m, "y_m": y_m, "size_m": (2 * HALF_M, 2 * HALF_M), "yaw_deg": 25.0}


@pytest.mark.parametrize(
    ("bearing_deg", "left", "right"),
    [(0, True, True), (45, True, False), (-45, False, True), (85, True, False), (120, False, False)],
)
def test_bump_tells_the_side(bearing_deg: float, left: bool, right: bool) -> None:
    x_m, y_m = polar(0.271, bearing_deg)
    stage = Stage(room(obstacles=({"kind": "circle", "radius_m": 0.1, "x_m": x_m, "y_m": y_m},)))
    bump = Bump(stage.world, stage.put(0, 0))
    assert (bump.send_req("left").value, bump.send_req("right").value) == (left, right)
    assert bump.get_value().value is (left or right)


def test_nothing_near_presses_nothing() -> None:
    stage = Stage()
    bump = Bump(stage.world, stage.put(2.8, 0))  # 30 mm from the wall
    assert bump.get_value().value is False


@pytest.mark.parametrize("make", ["evbot2", "roomba"])
@pytest.mark.parametrize(
    ("name", "bearing_deg"), [("left", 60), ("front_left", 20), ("front_right", -20), ("right", -60)]
)
def test_each_cliff_sensor_sees_the_drop_under_it(name: str, bearing_deg: float, make: MakeName) -> None:
    for turn_deg in (0, 90):
        x_m, y_m = polar(0.17 if make == "roomba" else 0.18, bearing_deg + turn_deg)
        stage = Stage(room(drops=(drop_at(0.5 + x_m, y_m),)))
        cliff = Cliff(stage.world, stage.put(0.5, 0, math.radians(turn_deg), make))
        names = ("left", "front_left", "front_right", "right")
        assert {each for each in names if cliff.send_req(each).value} == {name}
        assert cliff.get_value().value is True


def test_a_drop_behind_is_no_cliff() -> None:
    stage = Stage(room(drops=({"x_m": -1.0, "y_m": 0.0, "size_m": (1.9, 1.0)},)))
    cliff = Cliff(stage.world, stage.put(0, 0))
    assert cliff.get_value().value is False


@pytest.mark.parametrize(("off_m", "seen"), [(0.099, True), (0.101, False)])
@pytest.mark.parametrize("yaw_deg", [0.0, 30.0, 90.0])
def test_a_drop_ends_at_its_edge(off_m: float, seen: bool, yaw_deg: float) -> None:
    along, across = polar(1.0, yaw_deg)
    sensor_x_m, sensor_y_m = polar(0.17, 20)
    middle = {"x_m": sensor_x_m + off_m * along, "y_m": sensor_y_m + off_m * across}
    stage = Stage(room(drops=({**middle, "size_m": (0.2, 0.01), "yaw_deg": yaw_deg},)))
    cliff = Cliff(stage.world, stage.put(0, 0))
    assert cliff.send_req("front_left").value is seen


@pytest.mark.parametrize(
    ("name", "ahead_m", "left_m"), [("left", 0, 0.129), ("right", 0, -0.129), ("caster", 0.136, 0)]
)
def test_each_wheel_drops_over_a_drop(name: str, ahead_m: float, left_m: float) -> None:
    stage = Stage(room(drops=(drop_at(-left_m, 1.0 + ahead_m),)))
    drops = WheelDrop(stage.world, stage.put(0, 1.0, math.pi / 2))
    assert {each for each in ("left", "right", "caster") if drops.send_req(each).value} == {name}
    assert drops.get_value().value is True


def test_whole_floor_drops_nothing() -> None:
    stage = Stage()
    robot = stage.put(0, 0)
    assert WheelDrop(stage.world, robot).get_value().value is False
    assert Cliff(stage.world, robot).get_value().value is False


@pytest.mark.parametrize(("gap_m", "near"), [(0.005, True), (0.034, True), (0.04, False)])
def test_wall_sees_a_wall_along_the_right_hand_side(gap_m: float, near: bool) -> None:
    stage = Stage()
    along = stage.put(0, -2.0 + 0.17 + gap_m)
    opposite = stage.put(1.0, -2.0 + 0.17 + gap_m, math.pi)  # the wall is on its left
    assert Wall(stage.world, along).get_value().value is near
    assert Wall(stage.world, opposite).get_value().value is False
    assert Wall(stage.world, along).send_req("virtual").value is False


def test_what_is_felt_says_when() -> None:
    stage = Stage()
    robot = stage.put(0, 0)
    stage.clock.advance(0.5)
    for kind in (Bump, Cliff, WheelDrop, Wall):
        sensor = kind(stage.world, robot)
        assert sensor.get_value().stamp_s == pytest.approx(0.5)
        assert {sensor.send_req(known.name).stamp_s for known in sensor.info().requests} == {sensor.get_value().stamp_s}
