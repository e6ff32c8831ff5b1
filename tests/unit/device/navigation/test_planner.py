"""The planner against networkx's Dijkstra and plain geometry, and its errors."""

from __future__ import annotations

import math
import re
import tracemalloc
from itertools import combinations, pairwise

import networkx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eal_actors.device.navigation.grid import GridOrigin, OccupancyGrid
from eal_actors.device.navigation.planner import plan_path
from eal_actors.device.navigation.world_grid import grid_from_world
from eal_actors.device.world import load_world
from eal_actors.kernel.errors import NoPathError

Cell = tuple[int, int]


def random_grid(seed: int, rows: int, columns: int, share: float) -> tuple[OccupancyGrid, Cell, Cell]:
    """Return a grid with random walls, and two of its free cells."""
    random = np.random.default_rng(seed)
    cells = np.where(random.random((rows, columns)) < share, 100, 0).astype(np.int8)
    start, goal = ((int(random.integers(rows)), int(random.integers(columns))) for _ in "ab")
    cells[start] = cells[goal] = 0
    return OccupancyGrid(cells, 0.1, GridOrigin(-1, 2, float(random.uniform(-4, 4)))), start, goal


def steps_graph(grid: OccupancyGrid) -> networkx.Graph:
    """Return the free cells as a graph of steps to eight neighbours that cut no corner."""
    graph = networkx.Graph()
    free = {(int(row), int(column)) for row, column in np.argwhere(grid.cells == 0)}
    graph.add_nodes_from(free)
    for row, column in free:
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            if {(row + down, column + right), (row + down, column), (row, column + right)} <= free:
                length = grid.resolution_m * math.hypot(down, right)
                graph.add_edge((row, column), (row + down, column + right), weight=length)
    return graph


def sight_graph(grid: OccupancyGrid) -> networkx.Graph:
    """Return the centres of the free cells as a graph of all free lines between them."""
    graph = networkx.Graph()
    free = [(int(row), int(column)) for row, column in np.argwhere(grid.cells == 0)]
    centres = dict(zip(free, map(tuple, grid.centres(free)), strict=True))
    graph.add_nodes_from(free)
    for one, other in combinations(free, 2):
        if grid.is_line_free(centres[one], centres[other]):
            graph.add_edge(one, other, weight=math.dist(centres[one], centres[other]))
    return graph


def point_of(grid: OccupancyGrid, cell: Cell) -> tuple[float, float]:
    ((x, y),) = grid.centres(cell).tolist()
    return x, y


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), share=st.sampled_from((0.05, 0.15, 0.3, 0.45)))
def test_a_path_is_free_and_no_longer_than_dijkstras(seed: int, share: float) -> None:
    grid, start, goal = random_grid(seed, 25, 30, share)
    graph = steps_graph(grid)
    ends = point_of(grid, start), point_of(grid, goal)
    if not networkx.has_path(graph, start, goal):
        with pytest.raises(NoPathError, match="obstacles separate them"):
            plan_path(grid, *ends)
        return
    path = plan_path(grid, *ends)
    assert (path.points_m[0], path.points_m[-1]) == ends
    assert all(grid.is_line_free(one, other) for one, other in pairwise(path.points_m))
    assert path.length_m <= networkx.dijkstra_path_length(graph, start, goal) + 1e-9
    assert path.length_m >= math.dist(*ends) - 1e-9


@settings(max_examples=3, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), share=st.sampled_from((0.1, 0.2, 0.3)))
def test_a_path_is_almost_the_shortest_in_any_direction(seed: int, share: float) -> None:
    grid, start, goal = random_grid(seed, 8, 9, share)
    graph = sight_graph(grid)
    if networkx.has_path(graph, start, goal):
        path = plan_path(grid, point_of(grid, start), point_of(grid, goal))
        assert path.length_m <= 1.03 * networkx.dijkstra_path_length(graph, start, goal) + 1e-9


def test_starts_and_goals_anywhere_in_a_cell() -> None:
    grid = grid_from_world(load_world("maze")).inflated(0.17)
    random = np.random.default_rng(5)
    free = grid.centres(np.argwhere(~grid.blocked))
    for start, goal in zip(*(random.permutation(free)[:12] for _ in "ab"), strict=True):
        offsets = random.uniform(-0.02, 0.02, (2, 2))
        path = plan_path(grid, tuple(start + offsets[0]), tuple(goal + offsets[1]))
        assert all(grid.is_line_free(one, other) for one, other in pairwise(path.points_m))


def test_a_path_in_sight_is_one_line() -> None:
    grid = grid_from_world(load_world("empty")).inflated(0.2)
    assert plan_path(grid, (-2, -1), (2, 1.2)).points_m == ((-2, -1), (2, 1.2))
    assert plan_path(grid, (1, 1), (1, 1)).length_m == 0


def test_a_robot_that_stands_at_a_wall_gets_away_from_it() -> None:
    grid = grid_from_world(load_world("empty")).inflated(0.3)
    path = plan_path(grid, (-2.95, -1.9), (2, 1.2))
    assert path.points_m[0] == (-2.95, -1.9)
    assert grid.is_free(*path.points_m[1])
    assert path.length_m < 1.05 * math.dist((-2.95, -1.9), (2, 1.2))


@pytest.mark.parametrize(
    ("start", "goal", "message"),
    [
        (
            (0.5, 0.5),
            (5, 0.5),
            r"the goal \(5, 0.5\) is outside the map, which reaches from 0 to 4 m in x and",
        ),
        ((0.5, -1), (0.5, 0.5), r"the start \(0.5, -1\) is outside the map"),
        (
            (0.5, 0.5),
            (1.5, 0.5),
            r"the goal \(1.5, 0.5\) is inside an obstacle; the nearest free position is \(0.5,",
        ),
        ((1.5, 0.5), (0.5, 0.5), r"the start \(1.5, 0.5\) is inside an obstacle"),
        (
            (0.5, 0.5),
            (3.5, 2.5),
            r"the goal \(3.5, 2.5\) is on unknown floor; the nearest free position is \(3.5,",
        ),
        ((3.5, 2.5), (0.5, 0.5), r"the start \(3.5, 2.5\) is on unknown floor"),
        ((0.5, 0.5), (2.5, 1.5), r"no path leads from \(0.5, 0.5\) to \(2.5, 1.5\): obstacles separate them"),
        ((0.5, 0.5), (math.nan, 1.5), r"the goal \(nan, 1.5\) is outside the map"),
    ],
)
def test_an_impossible_goal_is_a_clear_error(
    start: tuple[float, float], goal: tuple[float, float], message: str
) -> None:
    cells = np.array([[0, 100, 0, 0], [0, 100, 0, 0], [0, 100, 0, -1]], np.int8)
    with pytest.raises(NoPathError, match=message):
        plan_path(OccupancyGrid(cells, 1.0, GridOrigin(0, 0)), start, goal)


def test_a_goal_nearer_to_a_wall_than_the_robots_radius_is_refused() -> None:
    grid = grid_from_world(load_world("empty")).inflated(0.2)
    with pytest.raises(NoPathError, match="is too near to an obstacle for the robot; the nearest free position is"):
        plan_path(grid, (0, 0), (2.9, 0))


@pytest.mark.parametrize("half", [3, 40, 90])
@pytest.mark.parametrize("yaw_rad", [0.0, 0.7])
def test_the_nearest_free_position_is_found_however_far_it_is(half: int, yaw_rad: float) -> None:
    cells = np.zeros((200, 300), np.int8)
    cells[100 - half : 100 + half, 120 - half : 120 + half] = 100
    grid = OccupancyGrid(cells, 0.1, GridOrigin(-3.0, 2.0, yaw_rad))
    goal = point_of(grid, (100, 118))
    centres = grid.centres(np.argwhere(~grid.blocked))
    x_m, y_m = centres[np.hypot(*(centres - goal).T).argmin()]
    with pytest.raises(NoPathError, match=re.escape(f"the nearest free position is ({x_m:.3g}, {y_m:.3g})")):
        plan_path(grid, point_of(grid, (1, 1)), goal)


def test_a_start_at_a_wall_of_a_large_map_takes_little_memory() -> None:
    grid = OccupancyGrid(np.zeros((1500, 1500), np.int8), 0.05, GridOrigin(0.0, 0.0)).inflated(0.2)
    plan_path(grid, (5.0, 5.0), (6.0, 5.0))  # makes the sums of the grid
    tracemalloc.start()
    try:
        plan_path(grid, (0.1, 5.0), (2.0, 5.0))
        _, most_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most_bytes < 16 * grid.cells.size  # the places of all cells take several times as much


def test_a_search_ends_at_its_bound() -> None:
    grid = grid_from_world(load_world("maze")).inflated(0.17)
    with pytest.raises(NoPathError, match="no path was found within 1,000 cells; use a coarser grid"):
        plan_path(grid, (-2.2, -2.2), (1.9, 1.9), most_cells=1000)
