"""Route: how far a robot has come along a polyline, its corners, and points that are the same."""

from __future__ import annotations

import math

import pytest

from eal_actors.device.motion.route import Route

SQUARE = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)]


def test_it_is_travelled_from_corner_to_corner() -> None:
    route = Route(SQUARE)
    assert route.length_m == 4.0
    route.advance(0.25, 0.1)
    assert (route.travelled_m, route.corner_m) == (0.25, 1.0)
    route.advance(0.1, 0.0)
    assert route.travelled_m == 0.25, "it never falls"
    for step in range(1, 20):
        route.advance(0.25 + 0.1 * step, 0.0)
    assert route.travelled_m == 1.0
    route.pass_corner()
    assert route.corner_m == 2.0


def test_a_route_that_crosses_itself_is_travelled_in_order() -> None:
    route = Route([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.5, 1.0), (0.5, -1.0)])
    for x_m in (0.2, 0.4, 0.5):
        route.advance(x_m, 0.0)
    assert route.travelled_m == pytest.approx(0.5)


def test_a_curve_of_short_legs_has_no_corners() -> None:
    route = Route([(math.cos(step / 10), math.sin(step / 10)) for step in range(30)])
    assert route.corner_m == route.length_m


def test_a_corner_between_many_points_is_one() -> None:
    route = Route([(step / 200, 0.0) for step in range(101)] + [(0.5, step / 200) for step in range(1, 101)])
    assert route.corner_m == pytest.approx(0.5, abs=0.011)
    route.pass_corner()
    assert route.corner_m == route.length_m == pytest.approx(1.0)


def test_waypoints_that_are_closer_than_a_step_of_an_encoder_are_still_a_way() -> None:
    route = Route([(step * 5e-5, 0.0) for step in range(10_001)])
    assert route.length_m == pytest.approx(0.5)
    assert route.end == (0.5, 0.0)


def test_a_route_ends_at_its_last_point() -> None:
    assert Route([(0.0, 0.0), (1.0, 0.0), (1.00005, 0.0)]).end == (1.00005, 0.0)


@pytest.mark.parametrize("points", [[(1.0, 2.0)], [(1.0, 2.0), (1.0, 2.0)], [(1.0, 2.0)] * 5])
def test_a_route_to_where_the_robot_stands_has_no_length(points: list[tuple[float, float]]) -> None:
    route = Route(points)
    route.advance(0.0, 0.0)
    assert (route.length_m, route.travelled_m, route.corner_m, route.end) == (0.0, 0.0, 0.0, (1.0, 2.0))
    assert route.point_at(0.0) == (1.0, 2.0)
