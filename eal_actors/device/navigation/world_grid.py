"""The occupancy grid of a world file: every cell that a thing touches, however slightly, is occupied."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eal_actors.device.navigation.grid import FREE, OCCUPIED, GridOrigin, Mask, OccupancyGrid, check_size
from eal_actors.device.world import BoxObstacle, Drop, MovableBox, WorldModel
from eal_actors.kernel.errors import ArgumentError

RESOLUTION_M: Final = 0.05
"""The default, which is also that of most maps for ROS."""
_TOUCHING_M: Final = 1e-9


def grid_from_world(world: WorldModel, resolution_m: float = RESOLUTION_M) -> OccupancyGrid:
    """Return the occupancy grid of a world: walls, obstacles, boxes where they start, beacons, drops, keep-out zones.

    Raises ArgumentError if the resolution is not positive, or gives too many cells.
    """
    if not (resolution_m > 0 and math.isfinite(resolution_m)):
        raise ArgumentError(f"the resolution of a grid must be over 0 m, not {resolution_m!r}")
    columns, rows = (max(math.ceil(size_m / resolution_m - _TOUCHING_M), 1) for size_m in world.size_m)
    check_size(rows, columns)
    origin = GridOrigin(-world.size_m[0] / 2, -world.size_m[1] / 2)
    painter = _Painter(rows, columns, resolution_m, origin)
    painter.outside(*world.size_m)
    for thing in (*world.solid_obstacles, *world.boxes, *world.beacons, *world.drops):
        if isinstance(thing, BoxObstacle | MovableBox | Drop):
            painter.rectangle(thing.x_m, thing.y_m, *thing.size_m, math.radians(thing.yaw_deg))
        else:
            painter.disc(thing.x_m, thing.y_m, thing.radius_m)
    for zone in world.keep_out:
        painter.polygon(zone)
    return OccupancyGrid(np.where(painter.occupied, np.int8(OCCUPIED), np.int8(FREE)), resolution_m, origin)


def close_zones(grid: OccupancyGrid, zones: Sequence[Sequence[tuple[float, float]]]) -> OccupancyGrid:
    """Return a grid, which may be turned, in which every cell that one of some keep-out zones touches is occupied."""
    rows, columns = grid.cells.shape
    painter = _Painter(rows, columns, 1.0, GridOrigin(0.0, 0.0))
    for zone in zones:
        painter.polygon([(u, v) for u, v in grid.continuous(zone).tolist()])
    return OccupancyGrid(np.where(painter.occupied, np.int8(OCCUPIED), grid.cells), grid.resolution_m, grid.origin)


class _Painter:
    """Marks the cells that shapes touch. Each shape is compared with the cells of its bounding box only."""

    def __init__(self, rows: int, columns: int, resolution_m: float, origin: GridOrigin) -> None:
        self.occupied: Mask = np.zeros((rows, columns), np.bool_)
        self._half_m = resolution_m / 2
        self._xs = origin.x_m + resolution_m * (np.arange(columns, dtype=np.float64) + 0.5)
        self._ys = origin.y_m + resolution_m * (np.arange(rows, dtype=np.float64) + 0.5)

    def outside(self, width_m: float, depth_m: float) -> None:
        """Mark the cells that reach through a wall, where the room is no multiple of the resolution."""
        self.occupied[:, self._xs + self._half_m > width_m / 2 + _TOUCHING_M] = True
        self.occupied[self._ys + self._half_m > depth_m / 2 + _TOUCHING_M] = True

    def rectangle(self, x_m: float, y_m: float, length_m: float, width_m: float, yaw_rad: float) -> None:
        """Mark a turned rectangle, by the separating axes of two rectangles."""
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        half_x_m = (abs(cos) * length_m + abs(sin) * width_m) / 2
        half_y_m = (abs(sin) * length_m + abs(cos) * width_m) / 2
        window, east, north = self._window(x_m - half_x_m, x_m + half_x_m, y_m - half_y_m, y_m + half_y_m)
        east, north = east - x_m, north - y_m
        cell_m = self._half_m * (abs(cos) + abs(sin))  # half the extent of a cell along either axis of the rectangle
        touched = np.abs(cos * east + sin * north) < length_m / 2 + cell_m - _TOUCHING_M
        touched &= np.abs(cos * north - sin * east) < width_m / 2 + cell_m - _TOUCHING_M
        self.occupied[window] |= touched

    def disc(self, x_m: float, y_m: float, radius_m: float) -> None:
        window, east, north = self._window(x_m - radius_m, x_m + radius_m, y_m - radius_m, y_m + radius_m)
        beyond_x_m = np.maximum(np.abs(east - x_m) - self._half_m, 0)
        beyond_y_m = np.maximum(np.abs(north - y_m) - self._half_m, 0)
        self.occupied[window] |= np.hypot(beyond_x_m, beyond_y_m) < radius_m - _TOUCHING_M

    def polygon(self, corners_m: Sequence[tuple[float, float]]) -> None:
        """Mark a polygon: its edges, and the cells whose centre it encloses by the even-odd rule."""
        xs, ys = zip(*corners_m, strict=True)
        window, east, north = self._window(min(xs), max(xs), min(ys), max(ys))
        inside = np.zeros(np.broadcast_shapes(east.shape, north.shape), np.bool_)
        for (x0, y0), (x1, y1) in zip(corners_m, (*corners_m[1:], corners_m[0]), strict=True):
            self.rectangle(
                (x0 + x1) / 2, (y0 + y1) / 2, math.hypot(x1 - x0, y1 - y0), 0.0, math.atan2(y1 - y0, x1 - x0)
            )
            if y0 != y1:
                inside ^= ((y0 > north) != (y1 > north)) & (east < x0 + (north - y0) * (x1 - x0) / (y1 - y0))
        self.occupied[window] |= inside

    def _window(
        self, west_m: float, east_m: float, south_m: float, north_m: float
    ) -> tuple[tuple[slice, slice], NDArray[np.floating], NDArray[np.floating]]:
        """Return the cells that a box touches, and their centres: x of shape (1, columns) and y of shape (rows, 1)."""
        columns = slice(*np.searchsorted(self._xs, (west_m - self._half_m, east_m + self._half_m)))
        rows = slice(*np.searchsorted(self._ys, (south_m - self._half_m, north_m + self._half_m)))
        return (rows, columns), self._xs[None, columns], self._ys[rows, None]
