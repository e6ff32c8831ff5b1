"""Phases: nobody ever comes near anybody, and everybody arrives."""

from __future__ import annotations

import itertools
import math
import random

import pytest

from eal_actors.device.world.model import Formation, formation_poses
from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.choreography.phasing import distance_to_path_m, path_distance_m, plan_phases
from eal_actors.lab.choreography.step import plan_shape

Point = tuple[float, float]
CLEARANCE_M = 0.6


def scattered(count: int, seed: int, room_m: float, apart_m: float = 0.65) -> list[Point]:
    generator = random.Random(seed)  # noqa: S311  # no secret
    points: list[Point] = []
    while len(points) < count:
        point = generator.uniform(-room_m, room_m), generator.uniform(-room_m, room_m)
        if all(math.dist(point, other) >= apart_m for other in points):
            points.append(point)
    return points


def along(way: tuple[Point, Point], steps: int = 60) -> list[Point]:
    (x, y), (to_x, to_y) = way
    return [(x + (to_x - x) * step / steps, y + (to_y - y) * step / steps) for step in range(steps + 1)]


@pytest.mark.parametrize("shape", ["line", "column", "wedge", "circle", "grid"])
@pytest.mark.parametrize(("count", "room_m"), [(3, 3.0), (9, 4.0), (25, 8.0)])
def test_whoever_is_fast_or_slow_the_clearance_is_kept(shape: str, count: int, room_m: float) -> None:
    for seed in range(5):
        starts = {f"r{number}": point for number, point in enumerate(scattered(count, seed, room_m))}
        rule = Formation.model_validate({"shape": shape, "count": count, "spacing_m": 0.8})
        plan = plan_shape(starts, rule, CLEARANCE_M)
        at = dict(starts)
        for phase in plan["phases"]:
            ways = {name: (at[name], (phase[name][0], phase[name][1])) for name in at}
            for one, other in itertools.combinations(ways, 2):
                assert path_distance_m(ways[one], ways[other]) >= CLEARANCE_M - 1e-6, f"seed {seed}"
            at = {name: way[1] for name, way in ways.items()}
        assert {name: tuple(place[:2]) for name, place in plan["places"].items()} == at
        wanted = sorted((pose.x_m, pose.y_m) for pose in formation_poses(rule))
        assert sorted(at.values()) == wanted


def test_ways_apart_is_what_points_along_them_say() -> None:
    generator = random.Random(1)  # noqa: S311  # no secret
    for _ in range(200):
        one, other = (
            ((generator.uniform(-2, 2), generator.uniform(-2, 2)), (generator.uniform(-2, 2), generator.uniform(-2, 2)))
            for _ in range(2)
        )
        sampled_m = min(distance_to_path_m(point, other) for point in along(one, 2000))
        assert path_distance_m(one, other) == pytest.approx(sampled_m, abs=2e-3)


def test_who_bars_the_way_later_goes_later() -> None:
    starts = [(0.0, 0.0), (1.0, 0.0)]
    assert plan_phases(starts, [(4.0, 0.0), (5.0, 0.0)], CLEARANCE_M).steps == [[-1, 1], [0, 1]]


def test_who_is_there_already_stays() -> None:
    assert plan_phases([(0.0, 0.0), (3.0, 0.0)], [(0.0, 0.0), (4.0, 0.0)], CLEARANCE_M).steps == [[-1, 1]]
    assert plan_phases([(0.0, 0.0)], [(0.0, 0.0)], CLEARANCE_M) == ([], [0])


def test_who_stands_in_the_way_goes_on_and_leaves_the_place() -> None:
    """Seed 1 of 9 robots in a grid: without places given anew, one of them finds no way in."""
    for seed in range(40):
        phases = plan_phases(scattered(9, seed, 4.0), grid(9), CLEARANCE_M)
        assert sorted(phases.place_of) == list(range(9)), f"seed {seed}"


def grid(count: int) -> list[Point]:
    rule = Formation.model_validate({"shape": "grid", "count": count, "spacing_m": 0.8})
    return [(pose.x_m, pose.y_m) for pose in formation_poses(rule)]


def test_places_too_near_each_other_are_refused() -> None:
    with pytest.raises(ArgumentError, match=r"two places are 0\.50 m apart; the margin needs 0\.60 m"):
        plan_phases([(0.0, 0.0), (1.0, 0.0)], [(5.0, 0.0), (5.5, 0.0)], CLEARANCE_M)
    with pytest.raises(ArgumentError, match=r"two robots stand 0\.30 m apart"):
        plan_phases([(0.0, 0.0), (0.3, 0.0)], [(5.0, 0.0), (6.5, 0.0)], CLEARANCE_M)
