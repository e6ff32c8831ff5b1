"""The distances of what stands round a camera beside the axis, in cells of about a degree.

Two thirds of a ring are in one frame only, and show no parallax. What stands upright on a level floor shows its
distance there as well: by the row in which it meets the floor. So each cell takes the distance that costs least of

- where two frames overlap, the difference of their brightness (a plane sweep);
- the colours: those below the row are more like the floor's, those above it less. The frames tell the floor's colours:
  what is above the horizon is no floor, and what is lowest mostly is;
- the difference from its neighbours, which counts less where the colours change, and more along the column, because
  things are upright. Higher up, things are seldom nearer;
- a little, the difference from the walls by features, where nothing else decides.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.lab.panorama.cylinder import Attitude, Floats, Image, Mask, wrapped_rad
from eal_actors.lab.panorama.parallax import KNOTS, DepthMap, TurnedCamera, knot_weights
from eal_actors.lab.panorama.propagation import Coupling, propagate, smoothed
from eal_actors.lab.panorama.ring import Ring

_COLUMNS: Final = 432  # cells round the ring
_CELL_RAD: Final = 2 * 2 * math.pi / _COLUMNS  # height of a cell
_ACROSS, _ALONG = 2, 8  # samples of a cell
_STEP_RAD: Final = 2 * math.pi / _COLUMNS / _ACROSS
_STEEPEST: Final = 1.0  # tangent of the elevation and depression of the map; beyond, its edges count
_LABEL: Final = 1.08  # ratio of the distances of two labels
_NEARNESS: Final = (0.5, 2.0)  # range of the labels, in those of the walls by features
_MOST_LABELS: Final = 48
_REACH_RAD: Final = 0.06  # beyond an overlap, in which the camera's position may move things
_BLUR_RAD: Final = 0.0018  # 1 px of a frame of 640 px and 60 degrees
_UNLIKE: Final = 15.0  # largest difference in grey levels that counts
_HIDDEN: Final = 1.0  # cost of a distance at which one frame does not show the cell, above that of the best one shown
_PARALLAX: Final = 0.15  # factor of these differences
_WALLS: Final = 0.0002
"""Cost of a distance that is e times that of the wall by features: decides where nothing else does."""
_MOST_RATIO: Final = 0.7
_BINS: Final = (12, 6, 6)  # widths of the bins of colours (CIE L*a*b*)
_LOWEST: Final = 0.7  # of the depression of the lower edge, from which most of a picture is floor
_RARE: Final = 2e-4  # share of pixels of a colour, below which it tells little
_MOST_ODDS: Final = 3.0
_COLOUR_BLUR_RAD: Final = 0.0036
_NEIGHBOURS: Final = (0.25, 10.0)  # factors of a difference of labels across and along the columns
_CHANGE: Final = 8.0  # difference in grey levels between two cells, from which they may be different things
_LEAST_FACTOR: Final = 0.02
_MOST_DIFFERENCE: Final = 8.0
_RISING: Final = 4.0


def depth_map(
    frames: Mapping[int, Image], camera: TurnedCamera, places: Mapping[int, Attitude], ring: Ring
) -> DepthMap:
    """Return the distances of what stands round the camera.

    The frames, by number, are of equal brightness, and their ring is closed. What the camera knows of the distances
    says which colours a cell has.

    Thread: any; it may take some seconds.
    """
    sweep = _Sweep(camera, places)
    picture = sweep.picture(frames)
    blurred = {number: _blurred(frame, _BLUR_RAD * camera.lens.focal_px) for number, frame in frames.items()}
    costs = _PARALLAX * sweep.differences(blurred, ring) + sweep.floor_costs(_floor_odds(picture, sweep.down))
    costs += sweep.wall_costs()
    return sweep.map_of(smoothed(propagate(costs, _coupling(sweep.cells(picture)))))


def _blurred(frame: Image, blur_px: float) -> Image:
    return np.asarray(cv2.GaussianBlur(frame, (0, 0), max(blur_px, 0.3)), np.uint8)


class _Sweep:
    """The samples and cells of the ring, and the labels of distances.

    Sample columns are counter-clockwise from yaw 0, rows from the top.
    """

    def __init__(self, camera: TurnedCamera, places: Mapping[int, Attitude]) -> None:
        self._camera: Final = camera
        self._places: Final = places
        bottom = min(camera.lens.height / 2 / camera.lens.focal_px, _STEEPEST)
        self.rows: Final = math.ceil(2 * bottom / _CELL_RAD)
        self._top: Final = -self.rows * _CELL_RAD / 2
        self.down: Final = self._top + (np.arange(self.rows * _ALONG) + 0.5) * _CELL_RAD / _ALONG
        nearness = camera.parallax.nearness
        least, most = np.clip((nearness.min() * _NEARNESS[0], max(nearness.max() * _NEARNESS[1], bottom)), 0.02, 2.0)
        count = min(math.ceil(math.log(most / least) / math.log(_LABEL)) + 1, _MOST_LABELS)
        self._labels: Final = np.geomspace(least, most, count)

    def yaws_rad(self, columns: NDArray[np.int64]) -> Floats:
        return (columns + 0.5) * _STEP_RAD

    def map_of(self, labels: Floats) -> DepthMap:
        """Return the distances of labels, (rows, columns); parts of a label count."""
        ends = np.log(self._labels[[0, -1]])
        shares = labels / (len(self._labels) - 1)
        return DepthMap(np.exp(ends[0] + shares * (ends[1] - ends[0])).astype(np.float32), self._top, _CELL_RAD)

    def wall_costs(self) -> Floats:
        """Return the cost of each label by the walls that features found, (columns, labels)."""
        yaws_rad = (np.arange(_COLUMNS) + 0.5) * 2 * math.pi / _COLUMNS
        walls = knot_weights(yaws_rad) @ self._camera.parallax.nearness
        ratios = np.log(self._labels / np.maximum(walls, self._labels[0])[:, np.newaxis])
        return np.asarray(_WALLS * np.minimum(np.abs(ratios), _MOST_RATIO), np.float32)

    def cells(self, samples: NDArray[Any]) -> Floats:
        """Return the means of the cells of samples (h, w, ...)."""
        rows, columns = samples.shape[0] // _ALONG, samples.shape[1] // _ACROSS
        parts = samples.reshape(rows, _ALONG, columns, _ACROSS, *samples.shape[2:])
        return np.asarray(parts.mean(axis=(1, 3), dtype=np.float32))

    def differences(self, frames: Mapping[int, Image], ring: Ring) -> Floats:
        """Return the cost of each label in each cell by the frames that both show it, (rows, columns, labels)."""
        shape = self.rows, _COLUMNS, len(self._labels)
        sums, shares = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        half_view_rad = self._camera.lens.half_view_rad
        for one, other, turn_rad in ring.neighbours():
            half_rad = min(half_view_rad - turn_rad / 2, turn_rad / 2) + _REACH_RAD
            first = math.floor((self._places[one].yaw_rad - turn_rad / 2 - half_rad) / _STEP_RAD / _ACROSS)
            columns = np.arange(first, first + math.ceil(2 * half_rad / _STEP_RAD / _ACROSS))
            samples = np.arange(columns[0] * _ACROSS, (columns[-1] + 1) * _ACROSS)
            floor, both = self._difference(frames, (one, other), 0.0, samples, len(self.down))
            for label, nearness in enumerate(self._labels):
                above = int(np.searchsorted(self.down, nearness))
                wall, both[:above] = self._difference(frames, (one, other), float(nearness), samples, above)
                apart = np.concatenate((wall, floor[above:]))
                sums[:, columns % _COLUMNS, label] += self.cells(apart * both)
                shares[:, columns % _COLUMNS, label] += self.cells(both)
        return _completed(sums, np.minimum(shares, 1))

    def _difference(
        self, frames: Mapping[int, Image], pair: tuple[int, int], nearness: float, columns: NDArray[np.int64], rows: int
    ) -> tuple[Floats, Mask]:
        """Return how two frames differ if all that stands there is so near, and where both show it, (rows, w)."""
        parallax = replace(self._camera.parallax, nearness=np.full(KNOTS, nearness), depths=None)
        camera = self._camera._replace(parallax=parallax)
        seen, reaches = zip(*(self._look(frames[n], camera, n, columns, rows) for n in pair), strict=True)
        apart = cv2.absdiff(*seen).mean(axis=2, dtype=np.float32)
        return np.minimum(apart, _UNLIKE), reaches[0] & reaches[1]

    def _look(
        self, frame: Image, camera: TurnedCamera, number: int, columns: NDArray[np.int64], rows: int
    ) -> tuple[Image, Mask]:
        attitude = self._places[number]
        right_rad = wrapped_rad(attitude.yaw_rad - self.yaws_rad(columns))
        x, y, reaches = camera.pixels(
            np.clip(right_rad, -math.pi / 2, math.pi / 2), self.down[:rows, np.newaxis], attitude
        )
        seen = cv2.remap(
            frame, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(seen, np.uint8), reaches

    def picture(self, frames: Mapping[int, Image]) -> Image:
        """Return the samples of the whole ring, each from the nearest frame, (h, w, 3)."""
        columns, numbers = np.arange(_COLUMNS * _ACROSS), sorted(self._places)
        yaws_rad = [self._places[number].yaw_rad for number in numbers]
        owners = np.abs(wrapped_rad(np.subtract.outer(yaws_rad, self.yaws_rad(columns)))).argmin(axis=0)
        picture = np.zeros((len(self.down), len(columns), 3), np.uint8)
        for at, number in enumerate(numbers):
            own = columns[owners == at]
            if own.size:
                picture[:, own], _ = self._look(frames[number], self._camera, number, own, len(self.down))
        return _blurred(picture, _COLOUR_BLUR_RAD / _STEP_RAD)

    def floor_costs(self, odds: Floats) -> Floats:
        """Return the cost of each label in each cell by the odds of floor (h, w), which is below the contact."""
        columns = odds.reshape(self.rows, _ALONG, _COLUMNS, _ACROSS).mean(axis=3)
        is_floor = (self._labels <= self.down[:, np.newaxis]).reshape(self.rows, _ALONG, -1)
        return np.asarray(-np.einsum("rsc,rsl->rcl", columns, is_floor) / _ALONG, np.float32)


def _completed(sums: Floats, shares: Floats) -> Floats:
    """Return the costs; a label at which the cell is not in both frames costs about as much as the best of the others.

    Both arguments are of the share of each cell that both frames show, (rows, columns, labels).
    """
    means = np.divide(sums, shares, out=np.full_like(sums, np.inf), where=shares >= 0.5)
    best = means.min(axis=2, keepdims=True)
    return np.where(np.isfinite(best), sums + (np.where(np.isfinite(best), best, 0) + _HIDDEN) * (1 - shares), 0)


def _floor_odds(picture: Image, down: Floats) -> Floats:
    """Return the logarithm of how much likelier each sample's colour is on the floor than elsewhere, (h, w)."""
    colours = cv2.cvtColor(picture, cv2.COLOR_RGB2LAB) // np.array(_BINS, np.uint8)
    sizes = tuple(256 // width + 1 for width in _BINS)
    bins = np.ravel_multi_index(tuple(colours[..., channel].astype(int) for channel in range(3)), sizes)
    lowest, above = (_shares(bins[rows], sizes) for rows in (down >= _LOWEST * down[-1], down < 0))
    odds = np.log((lowest + _RARE) / (above + _RARE))
    return np.asarray(odds.clip(-_MOST_ODDS, _MOST_ODDS)[bins])


def _shares(bins: NDArray[np.int64], sizes: tuple[int, ...]) -> Floats:
    """Return the share of each colour, smoothed over its neighbours, (n,)."""
    counts = np.bincount(bins.ravel(), minlength=math.prod(sizes)).reshape(sizes) / bins.size
    for axis in range(3):
        counts = (np.roll(counts, 1, axis) + 2 * counts + np.roll(counts, -1, axis)) / 4
    return np.asarray(counts.ravel())


def _coupling(cells: Floats) -> Coupling:
    """Return the costs of different distances in neighbouring cells of some colours, (rows, columns, 3)."""
    across, along = (
        factor * np.exp(-np.abs(change).mean(axis=2) / _CHANGE) + _LEAST_FACTOR
        for factor, change in zip(_NEIGHBOURS, (np.roll(cells, -1, 1) - cells, np.diff(cells, axis=0)), strict=True)
    )
    return Coupling(across, along, _MOST_DIFFERENCE, _RISING)
