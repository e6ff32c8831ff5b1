"""The whole way on real pixels: a simulated camera, the detector, the fleet's forwarding, the robots' estimates."""

from __future__ import annotations

import json
import math

import numpy as np

from eal_actors import Fleet, gather
from eal_actors.kernel.bundled import bundled_path


def test_uncalibrated_robots_of_the_arena_know_where_they_are() -> None:
    with Fleet.load(bundled_path("fleets/arena.yaml")) as arena:
        drive_and_judge(arena)
        judge_report_and_picture(arena)
        judge_floor(arena)


def judge_floor(arena: Fleet) -> None:
    """The lens bends the floor's markers; rectified, the edge of each is where the world file says, to 1 cm."""
    floor = arena["cameras-1"]["Floor"].get_value().get()
    assert floor.frame_id == "map"
    assert floor.value.shape == (340, 440, 3)
    for marker in arena.config.world.markers.floor:  # type: ignore[union-attr]
        row, column = round((1.7 - marker.y_m) * 100), round((marker.x_m + 2.2) * 100)
        for side in (-1, 1):
            black, white = (int(floor.value[row, column + side * away].mean()) for away in (9, 11))
            assert black < 110 < 160 < white, (marker.id, side)


def drive_and_judge(arena: Fleet) -> None:
    robots = [arena[name] for name in arena if name != "cameras-1"]
    gather([robot["Base"].send_cmd("f0.2") for robot in robots]).get()
    gather([robot["Base"].send_cmd("l60") for robot in robots]).get()
    arena.clock.sleep(0.3)
    for robot in robots:
        found, true = (np.array(robot[name].get_value().get().value) for name in ("Pose", "TruePose"))
        assert math.hypot(*(found - true)[:2]) < 0.005, robot.name
        assert abs(math.remainder(found[2] - true[2], math.tau)) < math.radians(1), robot.name


def judge_report_and_picture(arena: Fleet) -> None:
    cameras = arena["cameras-1"]
    fixes = cameras["Fixes"].get_value().get()
    assert fixes.frame_id == "map"
    assert fixes.value[:, 0].tolist() == [1, 2, 3, 4, 5, 6]
    report = json.loads(cameras["Fixes"].send_req("report").get().value)
    assert report["problems"] == []
    assert report["cameras"]["ceiling"]["floor_markers"] == [40, 41, 42, 43, 44, 45]
    assert cameras["Fixes"].get_status().get() == 0
    picture = cameras["Picture"].get_value().get().value
    assert picture.shape == (960, 1280, 3)
    green = (picture[..., 1] > 190) & (picture[..., 0] < 110) & (picture[..., 2] < 130)
    assert green.sum() > 6 * 100, "each of the six robots has a green frame"


def test_the_tracker_of_a_robot_is_connected_with_it() -> None:
    arena = Fleet.load(bundled_path("fleets/arena.yaml"))
    first = next(name for name, robot in arena.config.robots.items() if robot.pose.trackers)
    with arena.connect([first]):
        assert list(arena) == [name for name in arena.config.robots if name in (first, "cameras-1")]
