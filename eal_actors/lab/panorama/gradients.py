"""Edges and shades laid over each other: for overlaps that are too thin, or too plain, for features."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.lab.panorama.cylinder import Patch
from eal_actors.lab.panorama.shift import TILT_RAD, WINDOW_RAD, Shift

_SMOOTH_PX: Final = 1.5
_LEAST: Final = 0.5
"""Correlation of gradients that is believed."""
_CLEARLY_LESS: Final = 0.6
_CLEARLY_MORE_UNLIKE: Final = 2.5
_LEAST_UNLIKE: Final = 0.003
"""A second shift is no rival if it correlates by less than this share, or is so many times less alike.

How little alike is 1 - correlation, and that is what tells in a bare room: there the long edge of the floor makes every
shift look right, but one is right to a hair. Where a pattern repeats, or edges run along, there are rivals.
"""
_PEAK_RAD: Final = math.radians(0.8)
"""How far a peak reaches to either side."""
_LEAST_OVERLAP_RAD: Final = math.radians(3)
_STRUCTURE: Final = 2.0
"""Gradients, in grey levels a pixel (root mean square), that are more than noise: something is to be seen there."""

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Slopes:
    """How the brightness of an unrolled frame changes.

    Attributes:
        right: from left to right, in grey levels a pixel, (h, w); 0 where the frame does not reach.
        down: from the top down.
        reaches: 1 where both are known, else 0.
    """

    right: Array
    down: Array
    reaches: Array


def slopes_of(patch: Patch) -> Slopes:
    """Return how the brightness of a frame changes, without its noise."""
    smooth = cv2.GaussianBlur(patch.grey.astype(np.float32), (0, 0), _SMOOTH_PX)
    kernel = np.ones((7, 7), np.uint8)
    padded = cv2.copyMakeBorder(patch.reaches.astype(np.uint8), *(1,) * 4, cv2.BORDER_CONSTANT, value=0)
    reaches = cv2.erode(padded, kernel)[1:-1, 1:-1].astype(np.float32)
    right = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8) * reaches
    down = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8) * reaches
    return Slopes(right, down, reaches)


@dataclass(frozen=True, slots=True)
class Comparison:
    """What the gradients of two frames say.

    Attributes:
        shift: how far they are apart; None if that is not clear.
        contradicts: whether both have structure where they must overlap, and no shift makes them alike.
    """

    shift: Shift | None
    contradicts: bool


def compare_gradients(first: Slopes, second: Slopes, expected_px: float, px_per_rad: float) -> Comparison:
    """Lay two frames over each other at every shift that odometry allows.

    Args:
        first: of one frame.
        second: of another frame, unrolled to the same height.
        expected_px: how far odometry has the second to the right of the first.
        px_per_rad: pixels of the cylinder in a radian.
    """
    scores, rights_px, downs_px = _correlations(first, second, expected_px, px_per_rad)
    if not np.isfinite(scores).any():
        return Comparison(None, contradicts=False)
    row, column = divmod(int(np.argmax(scores)), scores.shape[1])
    best = float(scores[row, column])
    if best < _LEAST:
        structure = min(_structure(first, expected_px), _structure(second, -expected_px))
        return Comparison(None, contradicts=structure >= _STRUCTURE)
    reach = max(2, round(_PEAK_RAD * px_per_rad))
    if not _is_clear(scores.max(axis=0), column, reach):
        return Comparison(None, contradicts=False)
    right_px = float(rights_px[column]) + _between(scores[row, column - 1 : column + 2])
    down_px = 0.0  # as for a level camera, where only upright edges tell
    if _is_clear(scores[:, column], row, reach):
        down_px = float(downs_px[row]) + _between(scores[row - 1 : row + 2, column])
    return Comparison(Shift(right_px, down_px, "gradients", 1.0), contradicts=False)


def _correlations(first: Slopes, second: Slopes, expected_px: float, px_per_rad: float) -> tuple[Array, Array, Array]:
    """Return the correlation (m, n) of shifts down (m,) and to the right (n,); -inf where too little overlaps."""
    height, width = first.reaches.shape
    window_px, most_down_px = WINDOW_RAD * px_per_rad, math.floor(TILT_RAD * px_per_rad)
    rights_px = np.arange(math.ceil(expected_px - window_px), math.floor(expected_px + window_px) + 1)
    rights_px = rights_px[np.abs(rights_px) < width]
    downs_px = np.arange(-most_down_px, most_down_px + 1)
    if not len(rights_px):
        return np.empty((len(downs_px), 0)), rights_px, downs_px
    least_px, most_px = int(rights_px[0]), int(rights_px[-1])  # only what can overlap is looked at
    first = _columns(first, max(0, least_px), min(width, width + most_px))
    second = _columns(second, max(0, -most_px), min(width, width - least_px))
    offsets_px = rights_px - max(0, least_px) + max(0, -most_px)
    widths = first.reaches.shape[1] + second.reaches.shape[1]
    size = cv2.getOptimalDFTSize(height + most_down_px), cv2.getOptimalDFTSize(widths)

    def spectrum(array: Array) -> Array:
        return np.asarray(np.fft.rfft2(array, size))

    def sums(product: Array) -> Array:
        # The second frame's point (x, y) is the first one's (x + right, y + down).
        return np.asarray(np.fft.irfft2(product, size)[np.ix_(downs_px, offsets_px)])

    ones, others = spectrum(first.reaches), spectrum(second.reaches).conj()
    common = sums(
        spectrum(first.right) * spectrum(second.right).conj() + spectrum(first.down) * spectrum(second.down).conj()
    )
    first_power = sums(spectrum(first.right**2 + first.down**2) * others)
    second_power = sums(ones * spectrum(second.right**2 + second.down**2).conj())
    overlap = sums(ones * others)
    powers = np.sqrt(np.maximum(first_power, 1e-6) * np.maximum(second_power, 1e-6))
    least = _LEAST_OVERLAP_RAD * px_per_rad * height / 2
    return np.where(overlap >= least, common / powers, -np.inf), rights_px, downs_px


def _is_clear(profile: Array, best: int, reach: int) -> bool:
    """Return whether no shift beyond the reach of the best one is nearly as good; profile (n,)."""
    if not 0 < best < len(profile) - 1:
        return False
    is_far = np.abs(np.arange(len(profile)) - best) > reach
    rival, peak = float(profile[is_far].max(initial=-1.0)), float(profile[best])
    unlike = max(1 - peak, _LEAST_UNLIKE)
    return rival <= _CLEARLY_LESS * peak or 1 - rival >= _CLEARLY_MORE_UNLIKE * unlike


def _columns(slopes: Slopes, first: int, end: int) -> Slopes:
    return Slopes(slopes.right[:, first:end], slopes.down[:, first:end], slopes.reaches[:, first:end])


def _structure(slopes: Slopes, right_px: float) -> float:
    """Return how strong the gradients are where another frame overlaps whose axis is so far to the right."""
    width = slopes.reaches.shape[1]
    columns = slice(max(0, round(right_px)), width + min(0, round(right_px)))
    number = float(slopes.reaches[:, columns].sum())
    if not number:
        return 0.0
    power = float((slopes.right[:, columns] ** 2 + slopes.down[:, columns] ** 2).sum())
    return math.sqrt(power / number)


def _between(scores: Array) -> float:
    """Return where between its neighbours a peak is, by the parabola through the three."""
    before, peak, after = (float(score) for score in scores)
    bend = before - 2 * peak + after
    return (before - after) / (2 * bend) if math.isfinite(bend) and bend < 0 else 0.0
