"""ScanMap: an occupancy grid built from range scans and the poses at which they were taken.

Each cell has the logarithm of its odds of being occupied. A scan lowers it in the cells that its rays cross and raises
it where they end; the limits let a map follow things that move. The numbers are OctoMap's (Hornung et al., 2013).
The memory grows with the floor that was seen and is bounded by MAX_CELLS.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eal_actors.device.navigation.grid import UNKNOWN, GridOrigin, OccupancyGrid, check_size
from eal_actors.device.navigation.world_grid import RESOLUTION_M
from eal_actors.kernel.errors import ArgumentError

_HIT: Final = math.log(0.7 / 0.3)
_MISS: Final = math.log(0.4 / 0.6)
_LIMITS: Final = (math.log(0.12 / 0.88), math.log(0.97 / 0.03))
_MARGIN: Final = 40  # cells by which the array grows beyond what a scan needs, so that it grows seldom


class ScanMap:
    """A map that grows by scans. Raises ArgumentError if the length is not positive. Thread: one at a time."""

    def __init__(self, resolution_m: float = RESOLUTION_M) -> None:
        if not (0 < resolution_m < math.inf):
            raise ArgumentError(f"the resolution of a grid must be over 0 m, not {resolution_m!r}")
        self._resolution_m = resolution_m
        self._low = np.zeros(2, np.int64)  # row and column of the array's first cell, in cells from the map's origin
        self._odds: NDArray[np.float32] = np.zeros((0, 0), np.float32)
        self._is_seen: NDArray[np.bool_] = np.zeros((0, 0), np.bool_)

    def add(
        self, pose: tuple[float, float, float], ranges_m: ArrayLike, angles_rad: ArrayLike, max_range_m: float
    ) -> None:
        """Add a scan.

        Args:
            pose: x and y in m and yaw in rad of the sensor in the map frame, at the time of the scan.
            ranges_m: the distances along its rays, shape (n,). NaN and negative ones are skipped.
            angles_rad: the angles of its rays from straight ahead, counter-clockwise, shape (n,).
            max_range_m: greatest range of the sensor; a ray that reaches this far met nothing.

        Raises ArgumentError if the shapes differ, the pose or the greatest range is not finite, or the map would be too
        large.
        """
        ranges, angles = np.asarray(ranges_m, np.float64), np.asarray(angles_rad, np.float64)
        if ranges.shape != angles.shape or ranges.ndim != 1 or not np.isfinite((*pose, max_range_m)).all():
            shapes = f"{ranges.shape} and {angles.shape}"
            raise ArgumentError(f"a scan needs a finite pose and an angle for each range, not {pose}, {shapes}")
        with np.errstate(invalid="ignore"):
            valid = ranges >= 0
        if not valid.any():
            return
        reach = np.minimum(ranges[valid], max_range_m)
        yaw = pose[2] + angles[valid]
        directions = np.stack((np.sin(yaw), np.cos(yaw)))  # rows go up, columns go right
        middle = np.array([[pose[1]], [pose[0]]])
        steps = np.arange(0.0, reach.max(), self._resolution_m / 2)
        step, ray = np.nonzero(steps[:, None] <= reach)
        missed = self._cells(middle + steps[step] * directions[:, ray])
        is_hit = reach < max_range_m
        hit = self._cells(middle + reach[is_hit] * directions[:, is_hit])
        touched = np.concatenate((missed, hit), axis=1)
        low, high = touched.min(axis=1), touched.max(axis=1) + 1
        self._include(low, high)
        change = np.zeros(high - low, np.float32)
        change[tuple(missed - low[:, None])] = _MISS
        change[tuple(hit - low[:, None])] = _HIT  # wins over a ray that passed close by
        window = tuple(slice(*ends) for ends in zip(low - self._low, high - self._low, strict=True))
        self._odds[window] = (self._odds[window] + change).clip(*_LIMITS)
        self._is_seen[window] |= change != 0

    def _cells(self, points_m: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return rows and columns of points given as y and x, shape (2, n), in cells of the map frame."""
        return np.floor(points_m / self._resolution_m).astype(np.int64)

    def _include(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> None:
        """Grow the array so that it has the cells from `low` up to `high`, each row and column."""
        shape = np.array(self._odds.shape)
        if self._odds.size and (low >= self._low).all() and (high <= self._low + shape).all():
            return
        if self._odds.size:
            low, high = np.minimum(low, self._low), np.maximum(high, self._low + shape)
        low, high = low - _MARGIN, high + _MARGIN
        check_size(*(high - low).tolist())
        before, after = self._low - low, high - self._low - shape
        if not self._odds.size:
            before, after = high - low, np.zeros(2, np.int64)
        pads = np.stack((before, after), axis=1)
        self._odds, self._is_seen = np.pad(self._odds, pads), np.pad(self._is_seen, pads)
        self._low = low

    def grid(self) -> OccupancyGrid:
        """Return the map so far; floor that no ray has met is unknown. Raises ArgumentError if there is no scan yet."""
        if not self._is_seen.any():
            raise ArgumentError("a map of scans has no scan yet")
        low, high = (np.array([end(part) for part in np.nonzero(self._is_seen)]) for end in (np.min, np.max))
        window = tuple(slice(*ends) for ends in zip(low, high + 1, strict=True))
        percent = np.rint(100 / (1 + np.exp(-self._odds[window])))
        cells = np.where(self._is_seen[window], percent, UNKNOWN).astype(np.int8)
        y_m, x_m = ((self._low + low) * self._resolution_m).tolist()
        return OccupancyGrid(cells, self._resolution_m, GridOrigin(x_m, y_m))
