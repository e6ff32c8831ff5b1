"""OccupancyGrid: the floor as square cells that are free, occupied or unknown.

The values are those of the ROS message nav_msgs/OccupancyGrid: -1 is unknown, 0 to 100 the probability in percent that
something occupies the cell. Row 0 is at the origin and rows go up, columns go right, as in that message.

Invariant of `inflated`: from every point of a free cell, every occupied, unknown or outer point is at least the radius
away. So a robot may be anywhere in free cells, not only at their centres. Inflation from centre to centre, which costs
the same, is wrong by up to a diagonal of a cell.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eal_actors.device.navigation.regions import label_regions
from eal_actors.kernel.errors import ArgumentError

UNKNOWN: Final = -1
FREE: Final = 0
INFLATED: Final = 99
"""The value of cells that are too near to an obstacle for the centre of a robot, as in the costmaps of Nav2."""
OCCUPIED: Final = 100
OCCUPIED_FROM: Final = 65
"""Cells of at least this many percent are occupied: the default of ROS's map_saver."""
MAX_CELLS: Final = 16_000_000
"""200 x 200 m at 5 cm; a larger grid is refused before memory is."""
_ROUNDING: Final = 1e-9  # in cells

Mask = NDArray[np.bool_]


class GridOrigin(NamedTuple):
    """The corner of the first cell in the map frame, and the turn of the grid about it."""

    x_m: float
    y_m: float
    yaw_rad: float = 0.0


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """A map of square cells.

    Args:
        cells: int8 of shape (rows, columns): -1 unknown, 0 to 100 percent occupied; not copied, so do not change it.
        resolution_m: length of a cell's side.
        origin: the corner of the first cell.

    Raises ArgumentError if the grid is empty or too large, or a number is not finite.
    """

    cells: NDArray[np.int8]
    resolution_m: float
    origin: GridOrigin

    def __post_init__(self) -> None:
        check_size(*self.cells.shape)
        if not (self.resolution_m > 0 and all(map(math.isfinite, (self.resolution_m, *self.origin)))):
            raise ArgumentError(
                f"a grid needs a positive resolution and a finite origin, not {self.resolution_m} m at {self.origin}"
            )

    @cached_property
    def blocked(self) -> Mask:
        """Cells that no robot may enter: those occupied or unknown."""
        return (self.cells < 0) | (self.cells >= OCCUPIED_FROM)

    def inflated(self, radius_m: float) -> OccupancyGrid:
        """Return the grid for the centre of a round robot: cells that are too near to a blocked one are INFLATED.

        What lies outside the grid is blocked. See the invariant at the head of this module. On a grid of cells as large
        as the robot no cell beside an obstacle remains free: inflate a fine grid, and ask it with `is_line_free` for
        the points of a coarse one. Raises ArgumentError if the radius is negative or not finite.
        """
        if not (radius_m >= 0 and math.isfinite(radius_m)):
            raise ArgumentError(f"the radius of a robot must be 0 m or more, not {radius_m!r}")
        near = _dilate(self.blocked, radius_m / self.resolution_m - _ROUNDING)
        cells = np.where(near & ~self.blocked, np.int8(INFLATED), self.cells)
        return OccupancyGrid(cells, self.resolution_m, self.origin)

    def continuous(self, points_m: ArrayLike) -> NDArray[np.float64]:
        """Return points of the map frame, shape (n, 2), in columns and rows as real numbers.

        Cell (row, column) covers from `column` to `column + 1` and from `row` to `row + 1`.
        """
        x, y = (np.asarray(points_m, np.float64).reshape(-1, 2) - self.origin[:2]).T / self.resolution_m
        cos, sin = math.cos(self.origin.yaw_rad), math.sin(self.origin.yaw_rad)
        return np.stack((cos * x + sin * y, cos * y - sin * x), axis=1)

    def centres(self, cells: ArrayLike) -> NDArray[np.float64]:
        """Return the centres of cells given as (row, column), shape (n, 2), as x and y in the map frame in metres."""
        rows, columns = np.asarray(cells, np.float64).reshape(-1, 2).T + 0.5
        cos, sin = math.cos(self.origin.yaw_rad), math.sin(self.origin.yaw_rad)
        turned = np.stack((cos * columns - sin * rows, sin * columns + cos * rows), axis=1)
        return turned * self.resolution_m + self.origin[:2]

    @property
    def corners(self) -> NDArray[np.float64]:
        """The four corners of the grid in the map frame in metres, shape (4, 2)."""
        rows, columns = self.cells.shape
        return self.centres([(row - 0.5, column - 0.5) for row in (0, rows) for column in (0, columns)])

    def cell_at(self, x_m: float, y_m: float) -> tuple[int, int] | None:
        """Return row and column of the cell of a point, or None outside the grid."""
        ((u, v),) = self.continuous((x_m, y_m))
        rows, columns = self.cells.shape
        if not (0 <= u < columns and 0 <= v < rows):
            return None
        return int(v), int(u)

    def is_free(self, x_m: float, y_m: float) -> bool:
        """Return whether a point lies in a free cell; what lies outside is not free."""
        return bool(self.are_free((x_m, y_m))[0])

    def are_free(self, points_m: ArrayLike) -> Mask:
        """Return the same for points of shape (n, 2)."""
        uv = self.continuous(points_m)
        rows, columns = self.cells.shape
        inside = np.all((uv >= 0) & (uv < (columns, rows)), axis=1)
        free = np.zeros(len(uv), np.bool_)
        u, v = uv[inside].astype(int).T
        free[inside] = ~self.blocked[v, u]
        return free

    def is_line_free(self, start_m: ArrayLike, end_m: ArrayLike) -> bool:
        """Return whether every cell that a straight line in the map frame touches, be it at a corner, is free."""
        (start,), (end,) = self.continuous(start_m).tolist(), self.continuous(end_m).tolist()
        return self.is_cell_line_free(start, end)

    def is_cell_line_free(self, start: Sequence[float], end: Sequence[float]) -> bool:
        """Return the same for ends as `continuous` returns them."""
        (u0, v0), (u1, v1) = sorted((tuple(start), tuple(end)))
        rows, columns = self.cells.shape
        if not (u0 >= 0 and u1 <= columns and min(v0, v1) >= 0 and max(v0, v1) <= rows):
            return False
        first = max(math.floor(u0 - _ROUNDING), 0)
        last = min(math.floor(u1 + _ROUNDING), columns - 1)
        if u1 - u0 > _ROUNDING:
            borders = np.minimum(np.maximum(np.arange(first, last + 2), u0), u1)
            ends = v0 + (borders - u0) * ((v1 - v0) / (u1 - u0))
            low, high = np.minimum(ends[:-1], ends[1:]), np.maximum(ends[:-1], ends[1:])
        else:
            low, high = np.array([min(v0, v1)]), np.array([max(v0, v1)])
        lowest = np.maximum(low - _ROUNDING, 0).astype(int)
        above = np.minimum(high + _ROUNDING, rows - 1).astype(int) + 1
        column = np.arange(first, last + 1)
        return not (self._blocked_below[above, column] > self._blocked_below[lowest, column]).any()

    @cached_property
    def regions(self) -> NDArray[np.int32]:
        """The connected part of the free floor that each cell is in: 1 and more, 0 if blocked."""
        return label_regions(self.blocked)

    @cached_property
    def _blocked_below(self) -> NDArray[np.int32]:
        """Number of blocked cells below each row, by column; shape (rows + 1, columns)."""
        sums = np.zeros((self.cells.shape[0] + 1, self.cells.shape[1]), np.int32)
        np.cumsum(self.blocked, axis=0, out=sums[1:])
        return sums


def check_size(rows: int, columns: int) -> None:
    """Refuse a grid that is empty or too large. Raises ArgumentError if it has no cell, or more than MAX_CELLS."""
    if rows < 1 or columns < 1:
        raise ArgumentError("a grid needs at least one cell")
    if rows * columns > MAX_CELLS:
        raise ArgumentError(
            f"a grid of {columns} x {rows} cells is too large: at most {MAX_CELLS:,}; "
            "use a coarser resolution or a smaller floor"
        )


def _dilate(blocked: Mask, reach: float) -> Mask:
    """Return the cells of which a point is nearer than `reach` cells to a point of a blocked or an outer cell.

    The disc is a stack of rows, each a window whose number of blocked cells is a difference of two running sums: the
    cost grows with the radius, not with its square.
    """
    if reach <= 0:
        return blocked
    rows, columns = blocked.shape
    most = min(math.ceil(reach), max(rows, columns))
    padded = np.pad(blocked, most, constant_values=True)
    sums = np.zeros((padded.shape[0], padded.shape[1] + 1), np.int32)
    np.cumsum(padded, axis=1, out=sums[:, 1:])
    near = blocked.copy()
    for step in range(-most, most + 1):
        gap = max(abs(step) - 1, 0)
        if gap >= reach:
            continue
        half = min(math.ceil(math.sqrt(reach**2 - gap**2)), most)
        band = sums[most + step : most + step + rows]
        near |= band[:, most + half + 1 : most + half + 1 + columns] > band[:, most - half : most - half + columns]
    return near
