"""The occupancy grid: cells of a world, inflation and lines of sight, against plain geometry."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from eal_actors.device.navigation.grid import MAX_CELLS, GridOrigin, OccupancyGrid
from eal_actors.device.navigation.world_grid import grid_from_world
from eal_actors.device.world import WorldModel, load_world
from eal_actors.kernel.errors import ArgumentError


def grid_of(*rows: str, resolution_m: float = 1.0, origin: tuple[float, float, float] = (0, 0, 0)) -> OccupancyGrid:
    """Return a grid drawn with the north above: `#` occupied, `?` unknown, `.` free."""
    values = {"#": 100, "?": -1, ".": 0}
    return OccupancyGrid(
        np.array([[values[c] for c in row] for row in reversed(rows)], np.int8), resolution_m, GridOrigin(*origin)
    )


def drawn(grid: OccupancyGrid) -> list[str]:
    return ["".join("?" if v < 0 else "#" if v >= 65 else "." for v in row) for row in grid.cells[::-1]]


def world_of(**things: object) -> WorldModel:
    return WorldModel.model_validate({"version": 1, "name": "w", "size_m": [4, 3], **things})


def square_distance(one: tuple[int, int], other: tuple[int, int]) -> float:
    return math.hypot(*(max(abs(a - b) - 1, 0) for a, b in zip(one, other, strict=True)))


def test_a_world_has_one_cell_for_each_square_of_its_floor() -> None:
    grid = grid_from_world(world_of(obstacles=[{"kind": "box", "x_m": 0.5, "y_m": 0, "size_m": [1, 1]}]), 0.5)
    assert drawn(grid) == ["........", "........", "....##..", "....##..", "........", "........"]
    assert grid.cell_at(-2, -1.5) == (0, 0)
    assert grid.cell_at(1.99, 1.49) == (5, 7)
    assert grid.cell_at(2.0, 0.0) is None
    assert not grid.is_free(0.9, 0.4)
    assert grid.is_free(1.1, 0.4)


def test_a_cell_that_reaches_through_a_wall_is_occupied() -> None:
    grid = grid_from_world(world_of(), 0.35)
    assert grid.cells.shape == (9, 12)
    assert grid.blocked[8].all()
    assert grid.blocked[:, 11].all()
    assert not grid.blocked[:8, :11].any()


@pytest.mark.parametrize(
    "thing",
    [
        {"obstacles": [{"kind": "circle", "x_m": 0.3, "y_m": -0.2, "radius_m": 0.41}]},
        {"obstacles": [{"kind": "box", "x_m": 0.3, "y_m": -0.2, "size_m": [1.3, 0.6], "yaw_deg": 33}]},
        {"obstacles": [{"kind": "wall", "start_m": [-1, -1], "end_m": [1.2, 0.9], "thickness_m": 0.02}]},
        {"boxes": [{"name": "crate", "x_m": 0.3, "y_m": -0.2, "size_m": [0.7, 0.6], "yaw_deg": -12}]},
        {"beacons": [{"name": "post", "x_m": 0.3, "y_m": -0.2, "radius_m": 0.2}]},
        {"drops": [{"x_m": 0.3, "y_m": -0.2, "size_m": [0.7, 0.9], "yaw_deg": 80}]},
        {"keep_out": [[[-1, -1], [1, -1.2], [0.1, 0.0], [1.1, 1.3], [-0.7, 1]]]},
    ],
    ids=lambda thing: next(iter(thing)),
)
def test_the_cells_that_a_thing_touches_are_occupied_and_no_others(thing: dict[str, object]) -> None:
    resolution_m, fine = 0.1, 40
    world = world_of(**thing)
    grid = grid_from_world(world, resolution_m)
    covered = finely_covered(world, resolution_m / fine).reshape(30, fine, 40, fine).any(axis=(1, 3))
    assert covered.any()
    assert not (covered & ~grid.blocked).any()
    extra = grid.blocked & ~covered
    assert extra.sum() <= 0.03 * covered.sum() + 2  # cells of which a thing touches less than a sample


def finely_covered(world: WorldModel, step_m: float) -> NDArray[np.bool_]:
    """Return whether each point of a fine raster is covered; written without the code under test."""
    xs, ys = (np.arange(round(size_m / step_m)) * step_m + step_m / 2 - size_m / 2 for size_m in world.size_m)
    east, north = np.meshgrid(xs, ys)
    covered = np.zeros(east.shape, bool)
    for thing in (*world.solid_obstacles, *world.boxes, *world.beacons, *world.drops):
        if hasattr(thing, "radius_m"):
            covered |= (east - thing.x_m) ** 2 + (north - thing.y_m) ** 2 <= thing.radius_m**2
            continue
        turned = (east - thing.x_m + 1j * (north - thing.y_m)) * np.exp(-1j * math.radians(thing.yaw_deg))
        covered |= (np.abs(turned.real) <= thing.size_m[0] / 2) & (np.abs(turned.imag) <= thing.size_m[1] / 2)
    if world.keep_out:
        from matplotlib.path import Path as Outline

        points = np.stack((east.ravel(), north.ravel()), axis=1)
        for zone in world.keep_out:
            covered |= Outline(np.array(zone)).contains_points(points).reshape(east.shape)
    return covered


def test_inflation_keeps_the_radius_from_every_point_of_a_free_cell() -> None:
    grid = grid_of(*["........."] * 4, "....#....", *["........."] * 4)
    assert drawn(grid.inflated(0.5)) == [
        "#########",
        "#.......#",
        "#.......#",
        "#..###..#",
        "#..###..#",
        "#..###..#",
        "#.......#",
        "#.......#",
        "#########",
    ]


def test_unknown_cells_stay_unknown_and_keep_robots_away() -> None:
    inflated = grid_of("?.....", "......", "......", "......", "......").inflated(1.0)
    assert drawn(inflated) == ["?#####", "##...#", "#....#", "#....#", "######"]


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rows=st.integers(1, 14),
    columns=st.integers(1, 14),
    reach=st.floats(0, 9, allow_nan=False),
)
def test_inflation_is_the_distance_of_squares(seed: int, rows: int, columns: int, reach: float) -> None:
    cells = np.where(np.random.default_rng(seed).random((rows, columns)) < 0.12, 100, 0).astype(np.int8)
    grid = OccupancyGrid(cells, 0.1, GridOrigin(0, 0))
    inflated = grid.inflated(reach * 0.1).blocked
    sources = [
        (row, column)
        for row, column in product(range(-1, rows + 1), range(-1, columns + 1))
        if not (0 <= row < rows and 0 <= column < columns) or cells[row, column]
    ]
    for cell in product(range(rows), range(columns)):
        nearest = min(square_distance(cell, source) for source in sources)
        if abs(nearest - reach) > 1e-6:
            assert inflated[cell] == (nearest < reach or cells[cell] > 0), (cell, nearest)


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), yaw_rad=st.floats(-4, 4))
def test_a_free_line_crosses_no_blocked_cell(seed: int, yaw_rad: float) -> None:
    random = np.random.default_rng(seed)
    cells = np.where(random.random((12, 15)) < 0.08, 100, 0).astype(np.int8)
    grid = OccupancyGrid(cells, 0.25, GridOrigin(1.5, -2.5, yaw_rad))
    points = grid.centres(np.stack((random.integers(0, 12, 2), random.integers(0, 15, 2)), axis=1))
    if seed % 2:
        points = points + random.uniform(-0.08, 0.08, (2, 2))
    along = np.linspace(points[0], points[1], 3000)
    crossed = grid.are_free(along)
    if grid.is_line_free(points[0], points[1]):
        assert crossed.all()
    elif crossed.all():  # it touches a blocked cell at a corner, between two samples
        assert not all(grid.are_free(along + offset).all() for offset in _around(0.01))
    assert grid.is_line_free(points[0], points[1]) == grid.is_line_free(points[1], points[0])


def _around(distance_m: float) -> list[tuple[float, float]]:
    return [(distance_m * math.cos(a), distance_m * math.sin(a)) for a in np.arange(0, 2 * math.pi, math.pi / 4)]


def test_a_line_does_not_cut_a_corner() -> None:
    grid = grid_of("..", "#.")
    assert not grid.is_line_free((0.5, 1.5), (1.5, 0.5))
    assert grid.is_line_free((0.5, 1.5), (1.5, 1.5))
    assert grid.is_line_free((1.5, 1.5), (1.5, 0.5))
    assert not grid.is_line_free((0.5, 1.5), (2.5, 1.5))
    assert not grid.is_line_free((math.nan, 1.5), (1.5, 1.5))


def test_a_turned_grid_finds_its_cells() -> None:
    grid = grid_of("#..", "...", resolution_m=0.5, origin=(2, 3, math.pi / 2))
    assert grid.cell_at(1.75, 3.25) == (0, 0)
    assert grid.cell_at(1.25, 3.25) == (1, 0)
    assert not grid.is_free(1.25, 3.25)
    np.testing.assert_allclose(grid.centres([(1, 0), (0, 2)]), [(1.25, 3.25), (1.75, 4.25)])


@pytest.mark.parametrize("radius_m", [-0.1, math.nan, math.inf])
def test_a_radius_must_be_a_length(radius_m: float) -> None:
    with pytest.raises(ArgumentError, match="the radius of a robot must be 0 m or more"):
        grid_of("...").inflated(radius_m)


def test_a_grid_that_is_too_large_is_refused_before_it_takes_memory() -> None:
    with pytest.raises(ArgumentError, match=f"at most {MAX_CELLS:,}; use a coarser resolution"):
        grid_from_world(world_of(), 1e-5)
    with pytest.raises(ArgumentError, match="must be over 0 m, not 0"):
        grid_from_world(world_of(), 0)


def test_the_laboratory_leaves_room_for_its_robots() -> None:
    world = load_world("lab")
    grid = grid_from_world(world).inflated(0.17)
    assert all(grid.is_free(pose.x_m, pose.y_m) for pose in world.start_poses)
    assert 0.2 < grid.blocked.mean() < 0.4
