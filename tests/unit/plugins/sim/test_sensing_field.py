"""Compass, light and beacons: closed forms, and what hides what."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from eal_actors.plugin import EALData
from plugins.sim.models import MAKES
from plugins.sim.resources.sensing import Beacons, Bump, Cliff, Compass, Light, Range, Wall, WheelDrop
from tests.unit.plugins.sim.sensing import Stage, room

TOP_M = MAKES["roomba"].height_m


def lamp(x_m: float, y_m: float, z_m: float = 2.0, lumens: float = 1000.0) -> dict[str, float]:
    return {"x_m": x_m, "y_m": y_m, "z_m": z_m, "lumens": lumens}


def lux_of(*obstacles: dict[str, Any], lamps: tuple[dict[str, float], ...], **parts: Any) -> float:
    """Return the light at the middle of a room."""
    stage = Stage(room(obstacles=obstacles, lighting={"ambient_lux": 100.0, "lamps": lamps}, **parts))
    value: float = Light(stage.world, stage.put(0, 0)).get_value().value
    return value


def block(x_m: float, height_m: float) -> dict[str, Any]:
    return {"kind": "box", "x_m": x_m, "y_m": 0.0, "size_m": (0.2, 0.4), "yaw_deg": 90.0, "height_m": height_m}


def pillar(x_m: float, height_m: float) -> dict[str, Any]:
    return {"kind": "circle", "x_m": x_m, "y_m": 0.0, "radius_m": 0.1, "height_m": height_m}


# Compass.


@pytest.mark.parametrize(("turned_deg", "yaw_deg"), [(0, 0), (180, 180), (-180, 180), (270, -90), (725, 5)])
def test_the_compass_gives_the_wrapped_yaw(turned_deg: float, yaw_deg: float) -> None:
    stage = Stage()
    data = Compass(stage.world, stage.put(0, 0, math.radians(turned_deg))).get_value()
    assert data.value == pytest.approx(math.radians(yaw_deg))
    assert (data.unit, data.frame_id, data.stamp_s) == ("rad", "world", 0)


def test_compass_noise_has_the_mean_and_spread_that_was_set() -> None:
    stage = Stage()
    compass = Compass(stage.world, stage.put(0, 0, math.pi - 0.01))  # the noise takes it over the seam
    compass.set_config("noise_rad", EALData.of(0.05))
    assert compass.get_config("noise_rad") == 0.05
    values = np.array([compass.get_value().value for _ in range(4000)])
    assert values.max() <= math.pi
    assert values.min() > -math.pi
    errors = (values - (math.pi - 0.01) + math.pi) % (2 * math.pi) - math.pi
    assert abs(errors.mean()) < 4 * 0.05 / math.sqrt(4000)
    assert errors.std() == pytest.approx(0.05, rel=4 / math.sqrt(2 * 4000))


# Light.


def test_without_lamps_there_is_the_ambient_light() -> None:
    assert lux_of(lamps=()) == 100.0


def test_a_lamp_right_above_falls_off_with_the_square() -> None:
    lux = lux_of(lamps=(lamp(0, 0),))
    assert lux == pytest.approx(100 + 1000 / (4 * math.pi) / (2.0 - TOP_M) ** 2)


def test_a_lamp_aside_shines_by_the_cosine_too() -> None:
    up_m = 2.0 - TOP_M
    square = 1.5**2 + 1.0**2 + up_m**2
    lux = lux_of(lamps=(lamp(1.5, -1.0),))
    assert lux == pytest.approx(100 + 1000 / (4 * math.pi) / square * up_m / math.sqrt(square))


def test_lamps_add_up_and_one_below_the_sensor_gives_nothing() -> None:
    both = lux_of(lamps=(lamp(1, 0), lamp(-2, 1, lumens=300.0)))
    assert both - 100 == pytest.approx(lux_of(lamps=(lamp(1, 0),)) + lux_of(lamps=(lamp(-2, 1, lumens=300.0),)) - 200)
    assert lux_of(lamps=(lamp(1, 0, z_m=TOP_M / 2),)) == 100.0


@pytest.mark.parametrize("thing", [block, pillar])
def test_an_obstacle_hides_a_lamp_from_where_it_rises_above_the_line_of_sight(thing: Any) -> None:
    lamps = (lamp(2.0, 0.0),)
    edge_m = 1.2 if thing is block else 1.1  # the block is turned: its long side lies along x
    edge_m = 2 - edge_m  # the near edge of what stands at x = 1
    line_m = TOP_M + (2.0 - TOP_M) * edge_m / 2.0
    free = lux_of(lamps=lamps)
    assert lux_of(thing(1.0, line_m - 0.01), lamps=lamps) == free
    assert lux_of(thing(1.0, line_m + 0.01), lamps=lamps) == 100.0


@pytest.mark.parametrize("x_m", [-1.0, 2.5])
def test_an_obstacle_behind_the_robot_or_behind_the_lamp_hides_nothing(x_m: float) -> None:
    lamps = (lamp(2.0, 0.0),)
    assert lux_of(pillar(x_m, 2.5), lamps=lamps) == lux_of(lamps=lamps)


def test_a_box_hides_a_low_lamp() -> None:
    lamps = (lamp(2.0, 0.0, z_m=0.3),)
    crate = {"name": "crate", "x_m": 1.0, "y_m": 0.0, "height_m": 0.4}
    assert lux_of(lamps=lamps, boxes=(crate,)) == 100.0
    assert lux_of(lamps=lamps, boxes=({**crate, "y_m": 1.0},)) > 100.0


# Beacons.


def test_beacons_stand_in_the_order_of_the_world_file() -> None:
    ahead = {"name": "zeta", "x_m": 2.0, "y_m": 1.0}
    behind = {"name": "alpha", "x_m": -2.0, "y_m": -0.5}
    stage = Stage(room(beacons=(ahead, behind)))
    sensor = Beacons(stage.world, stage.put(0.5, 0, math.radians(90), name="r1"))
    data = sensor.get_value()
    expected = [(math.atan2(1, 1.5) - math.pi / 2, math.hypot(1.5, 1)), (math.atan2(2.5, -0.5), math.hypot(2.5, 0.5))]
    np.testing.assert_allclose(data.value, expected)
    assert (data.frame_id, data.stamp_s) == ("r1/base", 0)
    assert json.loads(sensor.send_req("names").value) == ["zeta", "alpha"]


def test_a_beacon_is_lost_beyond_its_reach() -> None:
    beacons = tuple({"name": f"b{n}", "x_m": 2.0, "y_m": 0.0, "reach_m": reach} for n, reach in enumerate((1.99, 2.0)))
    stage = Stage(room(beacons=beacons))
    values = Beacons(stage.world, stage.put(0, 0)).get_value().value
    assert np.isnan(values[0]).all()
    np.testing.assert_allclose(values[1], (0, 2))


@pytest.mark.parametrize(
    ("parts", "seen"),
    [
        ({"obstacles": (pillar(1.0, 0.8),)}, False),
        ({"obstacles": (block(1.0, 0.8),)}, False),
        ({"obstacles": (pillar(1.0, 0.3),)}, True),  # it is seen over it
        ({"obstacles": (pillar(-1.0, 0.8),)}, True),
        ({"obstacles": (pillar(2.5, 0.8),)}, True),
        ({"obstacles": ({"kind": "wall", "start_m": (1.0, -1.0), "end_m": (1.0, 1.0)},)}, False),
        ({"boxes": ({"name": "crate", "x_m": 1.0, "y_m": 0.0, "height_m": 0.9},)}, False),
        ({"boxes": ({"name": "crate", "x_m": 1.0, "y_m": 0.0, "height_m": 0.3},)}, True),
    ],
)
def test_what_stands_between_hides_a_beacon_if_it_is_high_enough(parts: dict[str, Any], seen: bool) -> None:
    stage = Stage(room(beacons=({"name": "post", "x_m": 2.0, "y_m": 0.0, "height_m": 1.0},), **parts))
    values = Beacons(stage.world, stage.put(0, 0)).get_value().value
    assert bool(np.isfinite(values).all()) is seen
    assert bool(np.isnan(values).all()) is not seen


def test_robots_and_other_beacons_hide_no_beacon() -> None:
    posts = ({"name": "near", "x_m": 1.0, "y_m": 0.0, "height_m": 2.0}, {"name": "far", "x_m": 2.0, "y_m": 0.0})
    stage = Stage(room(beacons=posts))
    robot = stage.put(0, 0)
    stage.put(0.5, 0)
    np.testing.assert_allclose(Beacons(stage.world, robot).get_value().value, [(0, 1), (0, 2)])


def test_a_world_without_beacons_shows_none() -> None:
    stage = Stage()
    sensor = Beacons(stage.world, stage.put(0, 0))
    assert sensor.get_value().value.shape == (0, 2)
    assert json.loads(sensor.send_req("names").value) == []


# All of them.


@pytest.mark.parametrize("kind", [Beacons, Bump, Cliff, Compass, Light, Range, Wall, WheelDrop])
def test_values_keep_what_the_information_promises(kind: Any) -> None:
    stage = Stage(room(beacons=({"name": "post", "x_m": 2.0, "y_m": 0.0},), lighting={"lamps": (lamp(1, 1),)}))
    sensor = kind(stage.world, stage.put(0, 0))
    info = sensor.info()
    assert info.description
    assert info.value is not None
    info.value.check(sensor.get_value(), info.name)
    for known in info.requests:
        assert known.returns is not None
        known.returns.check(sensor.send_req(known.name), known.name)
    for key in info.configs:
        key.value.check(EALData.of(sensor.get_config(key.name)), key.name)
