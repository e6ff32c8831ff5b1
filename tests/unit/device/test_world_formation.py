from __future__ import annotations

import math
from itertools import pairwise

import pytest

from eal_actors.device.world import Formation, StartPose, formation_poses

SHAPES = ("line", "column", "grid", "circle", "wedge")
Triple = tuple[float, float, float]


def poses(**keys: object) -> list[Triple]:
    return [(pose.x_m, pose.y_m, pose.yaw_deg) for pose in formation_poses(Formation.model_validate(keys))]


def test_a_line_stands_abreast_the_first_on_the_left() -> None:
    assert poses(shape="line", count=3, spacing_m=0.5) == [(0, 0.5, 0), (0, 0, 0), (0, -0.5, 0)]
    assert poses(shape="line", count=2, spacing_m=1, x_m=3, yaw_deg=90) == [(2.5, 0, 90), (3.5, 0, 90)]


def test_a_column_stands_behind_one_another_the_first_in_front() -> None:
    assert poses(shape="column", count=3, spacing_m=0.5) == [(0.5, 0, 0), (0, 0, 0), (-0.5, 0, 0)]
    assert poses(shape="column", count=2, spacing_m=1, y_m=-1, yaw_deg=90) == [(0, -0.5, 90), (0, -1.5, 90)]


def test_a_grid_is_filled_from_the_front_left() -> None:
    assert poses(shape="grid", count=4, spacing_m=2) == [(1, 1, 0), (1, -1, 0), (-1, 1, 0), (-1, -1, 0)]
    nine = poses(shape="grid", count=9, spacing_m=1)
    assert nine == [(1 - row, 1 - column, 0) for row in range(3) for column in range(3)]


@pytest.mark.parametrize(
    ("count", "rows", "columns"), [(1, 1, 1), (2, 1, 2), (3, 2, 2), (5, 2, 3), (7, 3, 3), (12, 3, 4), (100, 10, 10)]
)
def test_a_grid_has_as_many_rows_as_columns_or_one_less(count: int, rows: int, columns: int) -> None:
    places = poses(shape="grid", count=count, spacing_m=1)

    assert len({x for x, _, _ in places}) == rows
    assert len({y for _, y, _ in places}) == columns


def test_a_circle_goes_counter_clockwise_and_faces_outwards() -> None:
    four = poses(shape="circle", count=4, spacing_m=math.sqrt(2))
    assert [tuple(map(abs, place)) for place in four] == [(1, 0, 0), (0, 1, 90), (1, 0, 180), (0, 1, 90)]
    assert [(x, y) for x, y, _ in four] == [(1, 0), (0, 1), (-1, 0), (0, -1)]

    six = poses(shape="circle", count=6, spacing_m=2, x_m=5, yaw_deg=30)
    for number, (x, y, yaw_deg) in enumerate(six):
        turn_rad = math.radians(30 + 60 * number)
        assert (x - 5, y) == pytest.approx((2 * math.cos(turn_rad), 2 * math.sin(turn_rad)), abs=1e-6)
        assert math.cos(math.radians(yaw_deg)) == pytest.approx(math.cos(turn_rad), abs=1e-6)
        assert math.sin(math.radians(yaw_deg)) == pytest.approx(math.sin(turn_rad), abs=1e-6)


def test_a_circle_of_one_is_its_middle() -> None:
    assert poses(shape="circle", count=1, spacing_m=1, x_m=2, y_m=3, yaw_deg=90) == [(2, 3, 90)]


def test_a_wedge_points_ahead_then_left_and_right_by_turns() -> None:
    step = math.sqrt(0.5)  # of 1 m at 45 degrees
    ranks = [0, 1, 1, 2, 2]
    ahead = [-rank * step + 6 / 5 * step for rank in ranks]  # the mean of the ranks is 6 / 5
    left = [0, step, -step, 2 * step, -2 * step]

    places = poses(shape="wedge", count=5, spacing_m=1)
    assert places == [pytest.approx((x, y, 0), abs=1e-6) for x, y in zip(ahead, left, strict=True)]
    turned = poses(shape="wedge", count=5, spacing_m=1, yaw_deg=90)
    assert turned == [pytest.approx((-y, x, 90), abs=1e-6) for x, y in zip(ahead, left, strict=True)]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("count", [1, 2, 3, 6, 11])
@pytest.mark.parametrize("yaw_deg", [0, 35, -170])
def test_every_formation_keeps_its_spacing_middle_and_count(shape: str, count: int, yaw_deg: float) -> None:
    places = poses(shape=shape, count=count, spacing_m=0.7, x_m=1, y_m=-2, yaw_deg=yaw_deg)

    assert len(places) == count
    assert [sum(place[axis] for place in places) / count for axis in range(2)] == pytest.approx([1, -2], abs=1e-5)
    for number, (x, y, _) in enumerate(places):
        others = [math.hypot(x - ox, y - oy) for other, (ox, oy, _) in enumerate(places) if other != number]
        if others:
            assert min(others) == pytest.approx(0.7, abs=1e-5)


@pytest.mark.parametrize("shape", ["line", "column"])
def test_rows_are_straight(shape: str) -> None:
    places = poses(shape=shape, count=5, spacing_m=1, yaw_deg=20)

    steps = {(round(x1 - x0, 5), round(y1 - y0, 5)) for (x0, y0, _), (x1, y1, _) in pairwise(places)}
    assert len(steps) == 1


def test_poses_are_what_a_list_could_hold() -> None:
    (pose,) = formation_poses(Formation(shape="line", count=1, spacing_m=1.0, yaw_deg=270.0))

    assert pose == StartPose(x_m=0.0, y_m=0.0, yaw_deg=-90.0)
