"""The planner: a short path through free cells, by A* and then pulled taut.

A* runs on the eight neighbours of a cell. A diagonal step needs both cells beside it, so a path never cuts a corner.
Its path is up to 8 % longer than the shortest one in any direction; `_tauten` removes most of that. Theta*, which
tests lines of sight during its search, takes five times as long on open floors. DESIGN.md compares libraries.

Work is bounded: A* enters at most `most_cells` cells, and pulling a path taut tests a bounded number of lines.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from eal_actors.device.localization.pose_estimate import Point
from eal_actors.device.navigation.grid import FREE, INFLATED, UNKNOWN, Mask, OccupancyGrid
from eal_actors.kernel.errors import NoPathError

MOST_CELLS: Final = 500_000
"""Cells that a search enters at most: 35 x 35 m of free floor at 5 cm, in about three seconds."""
_DIAGONAL: Final = math.sqrt(2)
_PIECES: Final = 24  # points that are added to a path before each pass of pulling it taut
_PASSES: Final = 4
_BLIND: Final = 6  # so many points in a row that one does not see end its search for shortcuts
_WAYS_OUT: Final = 200  # cells that are tried to leave a start that is not free
_REACH: Final = 32  # cells around a point that are searched first for free ones: all of a large map take a gigabyte
_STRAIGHT: Final = 1e-9
_GAIN: Final = 0.999  # a pass that shortens a path by less is the last one

_Cell = tuple[int, int]


@dataclass(frozen=True)
class PlannedPath:
    """A path for the centre of a robot.

    `points_m` are x and y of its corners in the map frame, from the start to the goal.
    """

    points_m: tuple[Point, ...]

    @property
    def length_m(self) -> float:
        """Its length."""
        return _length(self.points_m)


def plan_path(grid: OccupancyGrid, start: Point, goal: Point, *, most_cells: int = MOST_CELLS) -> PlannedPath:
    """Return a short path between two points through free cells.

    A start that is too near to an obstacle, as where a robot stands at a wall, is left by the shortest free line.
    `grid` is inflated by the robot's radius; both ends are x and y in the map frame in metres. The search enters
    `most_cells` at most. Raises NoPathError if the start or the goal is outside the map, in an obstacle or in unknown
    floor; the goal is too near to an obstacle; nothing leads from one to the other; or the search reached `most_cells`.
    """
    start, goal = (float(start[0]), float(start[1])), (float(goal[0]), float(goal[1]))
    start_cell, goal_cell = _cell_of(grid, start, "start"), _cell_of(grid, goal, "goal")
    if grid.blocked[goal_cell]:
        raise NoPathError(f"{_reason(grid, goal_cell, goal, 'goal')}{_nearest_free(grid, goal)}")
    lead: tuple[Point, ...] = (start,)
    if grid.blocked[start_cell]:
        if grid.cells[start_cell] != INFLATED:
            raise NoPathError(_reason(grid, start_cell, start, "start"))
        lead = (start, _way_out(grid, start))
        start_cell = _cell_of(grid, lead[-1], "start")
    if grid.is_line_free(lead[-1], goal):
        return PlannedPath((*lead, goal))
    if grid.regions[start_cell] != grid.regions[goal_cell]:
        raise NoPathError(f"no path leads from {_shown(start)} to {_shown(goal)}: obstacles separate them")
    cells = _search(grid.blocked, start_cell, goal_cell, most_cells)
    points = [lead[-1], *((x, y) for x, y in grid.centres(cells[1:-1]).tolist()), goal]
    return PlannedPath((*lead[:-1], *_tauten(grid, points)))


def _cell_of(grid: OccupancyGrid, point: Point, role: str) -> _Cell:
    if (cell := grid.cell_at(*point)) is None:
        (west, east), (south, north) = ((min(axis), max(axis)) for axis in grid.corners.T.tolist())
        area = f"reaches from {west:g} to {east:g} m in x and from {south:g} to {north:g} m in y"
        raise NoPathError(f"the {role} {_shown(point)} is outside the map, which {area}")
    return cell


def _reason(grid: OccupancyGrid, cell: _Cell, point: Point, role: str) -> str:
    reasons = {UNKNOWN: "on unknown floor", INFLATED: "too near to an obstacle for the robot"}
    return f"the {role} {_shown(point)} is {reasons.get(int(grid.cells[cell]), 'inside an obstacle')}"


def _shown(point: Sequence[float]) -> str:
    return f"({point[0]:.3g}, {point[1]:.3g})"


def _by_distance(grid: OccupancyGrid, point: Point) -> list[Point]:
    """Return the centres of the free cells nearest to a point, the nearest first."""
    ((column, row),) = grid.continuous(point).astype(int).tolist()
    reach = _REACH
    while True:
        first = max(row - reach, 0), max(column - reach, 0)
        window = grid.blocked[first[0] : row + reach + 1, first[1] : column + reach + 1]
        free = grid.centres(np.argwhere(~window) + first)
        away_m = np.hypot(*(free - point).T)
        if window.size == grid.blocked.size or (away_m <= reach * grid.resolution_m).sum() >= _WAYS_OUT:
            return [(x, y) for x, y in free[np.argsort(away_m, kind="stable")[:_WAYS_OUT]].tolist()]
        reach *= 2


def _nearest_free(grid: OccupancyGrid, point: Point) -> str:
    """Return the end of a message: the free position nearest to a point."""
    nearest = _by_distance(grid, point)
    return f"; the nearest free position is {_shown(nearest[0])}" if nearest else "; the map has no free floor"


def _way_out(grid: OccupancyGrid, start: Point) -> Point:
    """Return the nearest free point that a straight line reaches through inflated and free cells alone."""
    passable = OccupancyGrid(np.where(grid.cells == INFLATED, FREE, grid.cells), grid.resolution_m, grid.origin)
    for point in _by_distance(grid, start):
        if passable.is_line_free(start, point):
            return point
    raise NoPathError(f"the start {_shown(start)} is too near to an obstacle, and no straight line leads out of there")


def _search(blocked: Mask, start: _Cell, goal: _Cell, most_cells: int) -> list[_Cell]:
    """Return the cells of a shortest path over eight neighbours in one region; raise NoPathError after `most_cells`."""
    width = blocked.shape[1] + 2  # a frame of blocked cells spares each step the test of the border
    walls = np.pad(blocked, 1, constant_values=True).tobytes()
    first, last = ((row + 1) * width + column + 1 for row, column in (start, goal))
    goal_row, goal_column = divmod(last, width)
    straight = ((step, 1.0, step, step) for step in (1, -1, width, -width))
    diagonal = ((up + side, _DIAGONAL, up, side) for up in (width, -width) for side in (1, -1))
    steps = (*straight, *diagonal)
    closed = bytearray(len(walls))
    cost, parent = {first: 0.0}, {first: first}
    heap = [(0.0, first)]
    entered = 0
    while (here := heapq.heappop(heap)[1]) != last:
        if closed[here]:
            continue
        closed[here] = 1
        entered += 1
        if entered > most_cells:
            raise NoPathError(f"no path was found within {most_cells:,} cells; use a coarser grid")
        so_far = cost[here]
        for step, length, beside, other in steps:
            there = here + step
            if walls[there] or closed[there] or walls[here + beside] or walls[here + other]:
                continue
            new = so_far + length
            if new < cost.get(there, math.inf):
                cost[there], parent[there] = new, here
                row, column = divmod(there, width)
                high, wide = abs(row - goal_row), abs(column - goal_column)
                heapq.heappush(heap, (new + max(high, wide) + (_DIAGONAL - 1) * min(high, wide), there))
    return _trace(parent, last, width)


def _trace(parent: dict[int, int], last: int, width: int) -> list[_Cell]:
    """Return the cells from the start, where parent and child are the same, to the last one."""
    indices = [last]
    while parent[indices[-1]] != indices[-1]:
        indices.append(parent[indices[-1]])
    return [(index // width - 1, index % width - 1) for index in reversed(indices)]


def _tauten(grid: OccupancyGrid, points: Sequence[Point]) -> tuple[Point, ...]:
    """Return a path as if pulled taut: shorter, through free cells, around the same obstacles."""
    path = _shortcut(grid, _corners(points))
    for _ in range(_PASSES):
        shorter = _shortcut(grid, _divided(path))
        if _length(shorter) > _GAIN * _length(path):
            break
        path = shorter
    return tuple(path)


def _corners(points: Sequence[Point]) -> list[Point]:
    """Return the points at which a path along cells turns, and its ends."""
    kept = [
        here
        for before, here, after in zip(points, points[1:], points[2:], strict=False)
        if abs((here[0] - before[0]) * (after[1] - here[1]) - (here[1] - before[1]) * (after[0] - here[0])) > _STRAIGHT
    ]
    return [points[0], *kept, points[-1]]


def _divided(path: Sequence[Point]) -> list[Point]:
    """Return a path with more points: at equal distances, and its corners."""
    piece = _length(path) / _PIECES
    divided = [path[0]]
    for (x0, y0), (x1, y1) in pairwise(path):
        count = max(math.ceil(math.hypot(x1 - x0, y1 - y0) / piece), 1) if piece > 0 else 1
        divided += [(x0 + (x1 - x0) * part / count, y0 + (y1 - y0) * part / count) for part in range(1, count)]
        divided.append((x1, y1))
    return divided


def _shortcut(grid: OccupancyGrid, points: Sequence[Point]) -> list[Point]:
    """Return the shortest sequence of points of a path whose lines are free: a shortest path among those in sight."""
    cells = grid.continuous(points).tolist()
    cost, parent = [0.0], [0]
    for index in range(1, len(points)):
        best, chosen, blind = math.inf, index - 1, 0
        for earlier in range(index - 1, -1, -1):
            length = cost[earlier] + math.dist(points[earlier], points[index])
            if earlier == index - 1 or grid.is_cell_line_free(cells[earlier], cells[index]):
                blind = 0
                if length < best + _STRAIGHT:  # of equal ones the farthest, which leaves fewer points
                    best, chosen = length, earlier
            elif (blind := blind + 1) >= _BLIND:
                break
        cost.append(best)
        parent.append(chosen)
    path = [len(points) - 1]
    while path[-1]:
        path.append(parent[path[-1]])
    return [points[index] for index in reversed(path)]


def _length(points: Sequence[Point]) -> float:
    return sum(math.dist(one, other) for one, other in pairwise(points))
