from __future__ import annotations

import itertools

import numpy as np

from eal_actors.device.navigation.grid import GridOrigin, OccupancyGrid
from eal_actors.device.navigation.traffic.bridges import find_bridges

POINTS = ((0.6, 0.6), (2.4, 2.4))


def two_rooms(door: int) -> OccupancyGrid:
    """Return two rooms of 1.5 x 3 m with a door of 0.45 m, for the centre of a robot with a radius of 0.15 m."""
    cells = np.zeros((60, 60), np.int8)
    cells[:, 29:31] = 100
    cells[door : door + 9, 29:31] = 0
    return OccupancyGrid(cells, 0.05, GridOrigin(0.0, 0.0)).inflated(0.15)


def test_a_bridge_leads_through_a_door() -> None:
    grid = two_rooms(20)
    ((first, between, last),) = find_bridges(grid, POINTS, [], 0.5)
    assert {first, last} == {0, 1}
    way = [POINTS[first], *between, POINTS[last]]
    assert all(grid.is_line_free(*ends) for ends in itertools.pairwise(way))


def test_the_next_plan_on_the_same_map_does_not_search_again() -> None:
    """The search took 43 of 59 ms of each plan in patrols, whose map is the same each time."""
    found = find_bridges(two_rooms(20), POINTS, [], 0.5)
    assert find_bridges(two_rooms(20), POINTS, [], 0.5) is found
    assert find_bridges(two_rooms(26), POINTS, [], 0.5) != found
