"""Bridges: ways that a lattice misses, such as through a narrow door or out of a niche.

A wave from all places at once goes over the free cells of the map. Where the waves of two parts meet first, the way
back to both places is a bridge. Out of a niche a wave from there goes to the nearest place.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Final, TypeAlias

import numpy as np

from eal_actors.device.localization.pose_estimate import Point
from eal_actors.device.navigation.grid import OCCUPIED, GridOrigin, OccupancyGrid
from eal_actors.device.navigation.traffic.lattice import Edge

Bridge: TypeAlias = tuple[int, tuple[Point, ...], int]
"""A place, the points between, and another place."""


_Cell: TypeAlias = tuple[int, int]
_NOWHERE: Final = (-1, -1)


def find_bridges(
    inflated: OccupancyGrid, points: Sequence[Point], edges: Sequence[Edge], longest_m: float
) -> tuple[Bridge, ...]:
    """Return the shortest bridges that connect what the map connects.

    `inflated` is the map for the centre of the largest robot; `points` and `edges` are the lattice.
    """
    cells = inflated.cells
    return _find(cells.tobytes(), cells.shape, inflated.resolution_m, inflated.origin, (*points,), (*edges,), longest_m)


@lru_cache(maxsize=4)  # the plans on one map ask the same: it took 43 of 59 ms of a plan
def _find(
    content: bytes,
    shape: tuple[int, ...],
    resolution_m: float,
    origin: GridOrigin,
    points: tuple[Point, ...],
    edges: tuple[Edge, ...],
    longest_m: float,
) -> tuple[Bridge, ...]:
    inflated = OccupancyGrid(np.frombuffer(content, np.int8).reshape(shape), resolution_m, origin)
    parts = _Parts(len(points))
    for here, there in edges:
        parts.join(here, there)
    cells = [inflated.cell_at(*point) for point in points]
    if parts.count <= len({inflated.regions[cell] for cell in cells if cell is not None}):
        return ()  # the lattice connects what the map connects
    found = []
    before, place_of, meetings = _spread(inflated, cells, parts)
    for _, near, far in sorted(meetings):
        first, last = place_of[near], place_of[far]
        if parts.join(first, last):
            crossed = [*reversed(list(_back(before, near))), *_back(before, far)]
            centres = [(float(x_m), float(y_m)) for x_m, y_m in inflated.centres(crossed)]
            way = list(_straightened(inflated, [points[first], *centres, points[last]]))
            found.append((first, tuple(_divided(way, longest_m))[1:-1], last))
    return tuple(found)


def way_out(
    inflated: OccupancyGrid,
    niche: Point,
    points: Sequence[Point],
    discs: Sequence[tuple[Point, float]],
    longest_m: float,
) -> tuple[list[Point], int] | None:
    """Return the points between a niche and the nearest place of the lattice, and that place; None if no way is free.

    `inflated` is the map for the robot's centre, `points` are the places of the lattice, none of which is in sight of
    the niche, and `discs` what else stands.
    """
    cells, half_m = inflated.cells.copy(), inflated.resolution_m / math.sqrt(2)
    centres = inflated.centres(np.argwhere(np.ones_like(inflated.blocked))) if discs else np.empty((0, 2))
    for at, keep_m in discs:
        keep_m = min(keep_m + half_m, math.dist(at, niche) - half_m)  # a niche that is too near is left all the same
        cells[(np.hypot(*(centres - at).T) < keep_m).reshape(cells.shape)] = OCCUPIED
    clear = OccupancyGrid(cells, inflated.resolution_m, inflated.origin)
    if (start := clear.cell_at(*niche)) is None:
        return None
    place_of = {clear.cell_at(*point): number for number, point in enumerate(points)}
    before, queue, blocked = {start: _NOWHERE}, deque([start]), np.pad(clear.blocked, 1, constant_values=True).tolist()
    while queue:
        cell = queue.popleft()
        if cell in place_of:
            place = place_of[cell]
            between = clear.centres([*reversed(list(_back(before, cell)))][1:-1]).tolist()
            way = _straightened(clear, [niche, *((x_m, y_m) for x_m, y_m in between), points[place]])
            return list(_divided(list(way), longest_m))[1:-1], place
        for beside in _beside(cell):
            if beside not in before and not blocked[beside[0] + 1][beside[1] + 1]:
                before[beside] = cell
                queue.append(beside)
    return None


class _Parts:
    """Disjoint sets of places."""

    def __init__(self, size: int) -> None:
        self._parents = list(range(size))
        self.count = size

    def root(self, place: int) -> int:
        while self._parents[place] != place:
            self._parents[place] = place = self._parents[self._parents[place]]
        return place

    def join(self, here: int, there: int) -> bool:
        """Unite two parts; return False if they were one."""
        first, last = self.root(here), self.root(there)
        self._parents[first] = last
        self.count -= first != last
        return first != last


def _spread(
    inflated: OccupancyGrid, cells: Sequence[_Cell | None], parts: _Parts
) -> tuple[dict[_Cell, _Cell], dict[_Cell, int], list[tuple[int, _Cell, _Cell]]]:
    """Return each cell's predecessor and place, and where waves of different parts meet, with the length of the way."""
    blocked = np.pad(inflated.blocked, 1, constant_values=True).tolist()
    before: dict[_Cell, _Cell] = {}
    steps: dict[_Cell, int] = {}
    place_of: dict[_Cell, int] = {}
    meetings: list[tuple[int, _Cell, _Cell]] = []
    for place, cell in enumerate(cells):
        if cell is not None:
            before[cell], steps[cell], place_of[cell] = _NOWHERE, 0, place
    queue = deque(before)
    while queue:
        cell = queue.popleft()
        for beside in _beside(cell):
            if beside in before:
                if parts.root(place_of[beside]) != parts.root(place_of[cell]):
                    meetings.append((steps[cell] + steps[beside], cell, beside))
            elif not blocked[beside[0] + 1][beside[1] + 1]:
                before[beside], steps[beside], place_of[beside] = cell, steps[cell] + 1, place_of[cell]
                queue.append(beside)
    return before, place_of, meetings


def _beside(cell: _Cell) -> tuple[_Cell, ...]:
    row, column = cell
    return (row, column + 1), (row + 1, column), (row, column - 1), (row - 1, column)


def _back(before: dict[_Cell, _Cell], cell: _Cell) -> Iterator[_Cell]:
    while cell != _NOWHERE:
        yield cell
        cell = before[cell]


def _straightened(inflated: OccupancyGrid, way: Sequence[Point]) -> Iterator[Point]:
    """Yield the corners of a way, each in sight of the one before."""
    here = 0
    yield way[0]
    while here < len(way) - 1:
        here = next(
            (there for there in range(len(way) - 1, here + 1, -1) if inflated.is_line_free(way[here], way[there])),
            here + 1,
        )
        yield way[here]


def _divided(way: Sequence[Point], longest_m: float) -> Iterator[Point]:
    """Yield the points of a way, with more between those that are far from each other."""
    yield way[0]
    for (x0, y0), (x1, y1) in itertools.pairwise(way):
        pieces = max(1, math.ceil(math.dist((x0, y0), (x1, y1)) / longest_m - 1e-9))
        for piece in range(1, pieces + 1):
            share = piece / pieces
            yield x0 + share * (x1 - x0), y0 + share * (y1 - y0)
