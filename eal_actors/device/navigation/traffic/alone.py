"""The way of a robot that travels by itself: short and straight, off the lattice that several robots need."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from eal_actors.device.localization.pose_estimate import Point
from eal_actors.device.navigation.grid import OCCUPIED_FROM, OccupancyGrid
from eal_actors.device.navigation.planner import plan_path
from eal_actors.device.navigation.traffic.roadmap import StandingDisc, Traveller
from eal_actors.kernel.errors import NoPathError

_MOST_CELLS: Final = 100_000
"""Cells that the search enters at most, in about half a second; a longer way is left to the lattice."""
_WALL_SHARE: Final = 0.5
"""The share of the margin that the way keeps from walls: it is pulled taut, and the robot strays by 2 cm."""
_THERE_M: Final = 0.01


def way_alone(
    grid: OccupancyGrid, traveller: Traveller, standing: Sequence[StandingDisc], margin_m: float
) -> tuple[Point, ...] | None:
    """Return the places on a short way to the goal, without the start; None if the lattice must find one.

    They are as near to each other as those of the lattice, so that a robot that is sent later waits no longer. The grid
    is not inflated; hulls keep `margin_m` from each other.
    """
    cells = grid.cells.copy()
    for thing in standing:
        _mark_disc(cells, grid, thing.at, thing.radius_m + (1 - _WALL_SHARE) * margin_m)
    keep_m = traveller.radius_m + _WALL_SHARE * margin_m
    free = OccupancyGrid(cells, grid.resolution_m, grid.origin).inflated(keep_m)
    is_there = math.dist(traveller.start, traveller.goal) < _THERE_M
    if is_there or not (free.is_free(*traveller.start) and free.is_free(*traveller.goal)):
        return None
    try:
        corners = plan_path(free, traveller.start, traveller.goal, most_cells=_MOST_CELLS).points_m
    except NoPathError:
        return None
    pitch_m = 2 * traveller.radius_m + margin_m
    return tuple(place for ends in pairwise(corners) for place in _places(*ends, pitch_m))


def _places(start: Point, end: Point, pitch_m: float) -> list[Point]:
    """Return the end of a line, and places before it that are at most a pitch apart."""
    (x0_m, y0_m), (x1_m, y1_m) = start, end
    count = max(1, math.ceil(math.dist(start, end) / pitch_m))
    shares = [number / count for number in range(1, count)]
    return [*((x0_m + share * (x1_m - x0_m), y0_m + share * (y1_m - y0_m)) for share in shares), end]


def _mark_disc(cells: np.ndarray, grid: OccupancyGrid, at: Point, radius_m: float) -> None:
    ((column, row),) = grid.continuous(at).tolist()
    reach = radius_m / grid.resolution_m
    rows, columns = (
        np.arange(max(0, math.floor(middle - reach)), max(0, min(size, math.ceil(middle + reach))))
        for middle, size in zip((row, column), cells.shape, strict=True)
    )
    beyond_row = np.maximum(np.abs(rows + 0.5 - row) - 0.5, 0)[:, None]
    beyond_column = np.maximum(np.abs(columns + 0.5 - column) - 0.5, 0)
    touched = np.hypot(beyond_row, beyond_column) < reach
    cells[np.ix_(rows, columns)] = np.where(touched, np.int8(OCCUPIED_FROM), cells[np.ix_(rows, columns)])
