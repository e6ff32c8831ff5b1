"""plugins/sim: its settings, who stands where, and what each make offers."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import ValidationError

from eal_actors.kernel.errors import PluginError, UnavailableError
from eal_actors.plugin import EALData
from plugins.sim import plugin as sim
from plugins.sim.arena import places
from tests.unit.plugins.sim.rig import Fleet, arena

COMMON = [
    "Base",
    "Odometry",
    "Battery",
    "Pose",
    "TruePose",
    "Bump",
    "Range",
    "Compass",
    "Light",
    "Beacons",
    "Camera",
    "Faults",
]


@pytest.mark.parametrize(
    ("model", "more"),
    [
        ("evbot2", []),
        ("evbot3", ["Turret"]),
        ("roomba", ["Cliff", "WheelDrop", "Wall", "Buttons", "Leds", "Song"]),
    ],
)
def test_each_make_has_its_own_resources(model: str, more: list[str]) -> None:
    robot = Fleet().add("r1", model=model)
    manifest = yaml.safe_load(Path(sim.__file__).with_name("plugin.yaml").read_text(encoding="utf-8"))
    assert list(robot.plugin.list_resources()) == COMMON + more
    assert set(COMMON + more) <= set(manifest["resources"])
    for name in COMMON + more:
        resource = robot.resource(name)
        assert (resource.info().name, type(resource).__name__) == (name, name)


def test_values_keep_what_the_information_promises() -> None:
    for model in ("evbot2", "evbot3", "roomba"):
        robot = Fleet().add("r1", (0, 0, 0), model=model)
        for name in robot.plugin.list_resources():
            resource = robot.resource(name)
            info = resource.info()
            assert info.description
            if info.value and "get_value" in info.methods:
                info.value.check(EALData.of(resource.get_value()), name)
            for known in info.requests:
                assert known.returns is not None
                known.returns.check(EALData.of(resource.send_req(known.name)), known.name)


@pytest.mark.parametrize(
    "settings", [{}, {"model": "evbot9"}, {"model": "roomba", "start": {"x_m": 0.0}}, {"modle": 1}]
)
def test_settings_are_strict(settings: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        sim.Settings.model_validate(settings)


@pytest.mark.parametrize("start", [(2.9, 0, 0), (9, 0, 0), (0, -2.1, 0), (1.0, 1.0, 0), (-1.2, -1.0, 0)])
def test_a_start_that_is_not_free_is_refused(start: tuple[float, float, float]) -> None:
    fleet = Fleet(arena(obstacles=[{"kind": "circle", "x_m": 1.2, "y_m": 1.0, "radius_m": 0.1}]))
    fleet.add("there", (-1.0, -1.0, 0))
    with pytest.raises(PluginError, match="'r1' cannot start"):
        fleet.add("r1", start)


def test_places_are_given_in_the_order_of_names_whoever_joins_first() -> None:
    def places(names: Iterable[str]) -> dict[str, list[float]]:
        fleet = Fleet()
        robots = [fleet.add(name) for name in names]
        return {robot.name: robot.pose for robot in robots}

    names = [f"r{number}" for number in range(9)]
    assert places(names) == places(reversed(names))
    assert len({tuple(pose) for pose in places(names).values()}) == len(names)


def test_a_full_world_has_no_place_left() -> None:
    fleet = Fleet(arena(1.0, 1.0))
    first, second = fleet.add("a"), fleet.add("b")
    assert first.pose == [0, 0, 0]
    with pytest.raises(UnavailableError, match="no free place for robot 'b'"):
        second.pose_sensor.get_value()
    with pytest.raises(UnavailableError):
        fleet.run(second.base.send_cmd("g"))
    second.base.halt()


def test_a_robot_that_joins_again_is_where_it_was() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    motion = robot.base.send_cmd("g")
    next(motion)
    fleet.clock.advance(1.0)
    sim.disconnect(robot.plugin)
    left_at = robot.pose
    fleet.clock.advance(1.0)
    again = fleet.add("r1", (0, 0, 0))
    assert again.pose == left_at
    assert again.base.get_status() == 0
    with pytest.raises(PluginError, match="already"):
        fleet.add("r1", model="evbot3")


def test_numbers_in_names_count() -> None:
    fleet = Fleet(arena(9.0, 9.0, starts={"shape": "line", "count": 11, "spacing_m": 0.6}))
    robots = {number: fleet.add(f"r{number}") for number in (10, 2, 11, 1, *range(3, 10))}
    places_m = [robots[number].pose[1] for number in range(1, 12)]
    assert places_m == sorted(places_m, reverse=True)


def test_a_place_of_the_grid_is_over_no_drop() -> None:
    fleet = Fleet(arena(4.0, 4.0, drops=({"x_m": 0.0, "y_m": 0.0, "size_m": (1.0, 1.0)},)))
    x_m, y_m, _ = fleet.add("r1").pose
    assert max(abs(x_m), abs(y_m)) >= 0.5 + 0.17


def test_start_poses_of_the_world_are_given_first_in_the_order_of_names() -> None:
    starts = ({"x_m": 1.0, "y_m": 1.0, "yaw_deg": 90.0}, {"x_m": -2.9, "y_m": 0.0}, {"x_m": -1.0, "y_m": -1.0})
    fleet = Fleet(arena(starts=starts))
    third, first, second = fleet.add("c"), fleet.add("a"), fleet.add("b")
    assert first.pose == pytest.approx([1, 1, 1.5707963])
    assert second.pose == [-1, -1, 0]  # the place between is too near the wall
    assert third.pose == [0, 0, 0]  # the first of the grid


def test_a_world_without_calibration_turns_too_little() -> None:
    turned = {}
    for calibrated in (True, False):
        robot = Fleet().add("r1", (0, 0, 0), model="evbot2", noise=True, calibrated=calibrated)
        robot.do("l90")
        turned[calibrated] = robot.pose[2] / 1.5707963
    assert turned[True] == pytest.approx(0.98, abs=0.02)
    assert turned[False] == pytest.approx(1 / 1.2, abs=0.02)


def test_robots_find_places_in_a_room_of_any_size() -> None:
    """The grid of places had one for each metre of the room, and filled the memory."""
    found = list(places(arena(5.0, 10_000.0)))
    assert found[0] == (0.0, 0.0, 0.0)
    assert len(found) < 10_000
    assert len(list(places(arena(10_000.0, 10_000.0)))) < 100_000
