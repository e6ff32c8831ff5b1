"""Bridges: ways between parts of a lattice that its places miss, such as through a narrow door.

A wave from all places at once goes over the free cells of the map. Where the waves of two parts meet first, the way
back to both places is a bridge.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Final, TypeAlias

import numpy as np

from eal_actors.device.navigation.grid import OccupancyGrid
from eal_actors.device.navigation.traffic.lattice import Edge, Point

Bridge: TypeAlias = tuple[int, list[Point], int]
"""A place, the points between, and another place."""

_Cell: TypeAlias = tuple[int, int]
_NOWHERE: Final = (-1, -1)


def find_bridges(
    inflated: OccupancyGrid, points: Sequence[Point], edges: Sequence[Edge], longest_m: float
) -> list[Bridge]:
    """Return the shortest bridges that connect what the map connects.

    Args:
        inflated: the map for the centre of the largest robot.
        points: the places of the lattice.
        edges: the ways between them.
        longest_m: length of the longest straight piece.
    """
    parts = _Parts(len(points))
    for here, there in edges:
        parts.join(here, there)
    if parts.count <= 1:
        return []
    found = []
    before, place_of, meetings = _spread(inflated, points, parts)
    for _, near, far in sorted(meetings):
        first, last = place_of[near], place_of[far]
        if parts.join(first, last):
            cells = [*reversed(list(_back(before, near))), *_back(before, far)]
            centres = [(float(x_m), float(y_m)) for x_m, y_m in inflated.centres(cells)]
            way = list(_straightened(inflated, [points[first], *centres, points[last]]))
            found.append((first, list(_divided(way, longest_m))[1:-1], last))
    return found


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
    inflated: OccupancyGrid, points: Sequence[Point], parts: _Parts
) -> tuple[dict[_Cell, _Cell], dict[_Cell, int], list[tuple[int, _Cell, _Cell]]]:
    """Return each cell's predecessor and place, and where waves of different parts meet, with the length of the way."""
    blocked = np.pad(inflated.blocked, 1, constant_values=True).tolist()
    before: dict[_Cell, _Cell] = {}
    steps: dict[_Cell, int] = {}
    place_of: dict[_Cell, int] = {}
    meetings: list[tuple[int, _Cell, _Cell]] = []
    for place, point in enumerate(points):
        cell = inflated.cell_at(*point)
        if cell is not None:
            before[cell], steps[cell], place_of[cell] = _NOWHERE, 0, place
    queue = deque(before)
    while queue:
        cell = row, column = queue.popleft()
        for beside in ((row, column + 1), (row + 1, column), (row, column - 1), (row - 1, column)):
            if beside in before:
                if parts.root(place_of[beside]) != parts.root(place_of[cell]):
                    meetings.append((steps[cell] + steps[beside], cell, beside))
            elif not blocked[beside[0] + 1][beside[1] + 1]:
                before[beside], steps[beside], place_of[beside] = cell, steps[cell] + 1, place_of[cell]
                queue.append(beside)
    return before, place_of, meetings


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
