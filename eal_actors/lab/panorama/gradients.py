"""Offset of two frames by correlation of their gradients, for overlaps with too few features."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.lab.panorama.cylinder import TILT_RAD, WINDOW_RAD, Shift
from eal_actors.lab.panorama.patches import Patch

_SMOOTH_PX: Final = 1.5
_LEAST: Final = 0.5  # smallest accepted correlation of gradients
_CLEARLY_LESS: Final = 0.6
_CLEARLY_MORE_UNLIKE: Final = 2.5
_LEAST_UNLIKE: Final = 0.003
"""A second shift is no rival if its correlation is below this share of the best, or its dissimilarity is so many times
that of the best.

Dissimilarity is 1 - correlation. It decides in a bare room, where the long edge of the floor makes every shift look
similar, but only one fits exactly. Repeating patterns and edges along the shift have rivals.
"""
_LEAST_PROMINENCE: Final = 0.1  # of a doubtful shift: its correlation above that of most shifts
_POINTS: Final = 5
_POINTS_REACH: Final = 0.3  # share of the height
_SIGMA_PX: Final = 1.0
_PEAK_RAD: Final = math.radians(0.8)  # half width of a peak
_LEAST_OVERLAP_RAD: Final = math.radians(3)
_STRUCTURE: Final = 2.0  # gradients above noise, in grey levels per pixel (root mean square): the picture has structure

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Gradients:
    """Brightness gradients of a projected frame to the right and down, in grey levels per pixel, (h, w).

    They are 0 outside of the frame; `reaches` is 1 where both are known, else 0.
    """

    right: Array
    down: Array
    reaches: Array


def gradients_of(patch: Patch) -> Gradients:
    """Return the smoothed gradients of a frame."""
    smooth = cv2.GaussianBlur(patch.grey.astype(np.float32), (0, 0), _SMOOTH_PX)
    kernel = np.ones((7, 7), np.uint8)
    padded = cv2.copyMakeBorder(patch.reaches.astype(np.uint8), *(1,) * 4, cv2.BORDER_CONSTANT, value=0)
    reaches = cv2.erode(padded, kernel)[1:-1, 1:-1].astype(np.float32)
    right = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8) * reaches
    down = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8) * reaches
    return Gradients(right, down, reaches)


@dataclass(frozen=True, slots=True)
class Comparison:
    """The offset of two frames by their gradients, or None if it is ambiguous.

    It `contradicts` if both have structure where they must overlap, but no shift makes them similar.
    """

    shift: Shift | None
    contradicts: bool


def compare_gradients(first: Gradients, second: Gradients, expected_px: float, px_per_rad: float) -> Comparison:
    """Correlate two frames of one height at every shift that odometry allows.

    By odometry the second frame is `expected_px` to the right of the first.
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
    right_px = float(rights_px[column]) + _peak_offset(scores[row, column - 1 : column + 2])
    down_px = 0.0  # as for a level camera, if only vertical edges fix the shift
    if _is_clear(scores[:, column], row, reach):
        down_px = float(downs_px[row]) + _peak_offset(scores[row - 1 : row + 2, column])
    return Comparison(_shift_of(right_px, down_px, first.reaches.shape[0]), contradicts=False)


@dataclass(frozen=True, slots=True)
class DoubtfulShift:
    """A shift that is too weak to be believed between strangers.

    `prominence` is its correlation above the median of all shifts, less where odometry is far from it.
    """

    shift: Shift
    prominence: float


def doubtful_shift(first: Gradients, second: Gradients, expected_px: float, px_per_rad: float) -> DoubtfulShift | None:
    """Return the shift that stands out most near `expected_px`, that by odometry; None if no other is clearly less."""
    scores, rights_px, _ = _correlations(first, second, expected_px, px_per_rad)
    profile = scores.max(axis=0, initial=-np.inf)
    if not np.isfinite(profile).all() or len(profile) < 3:
        return None
    weights = np.exp(-0.5 * ((rights_px - expected_px) / (WINDOW_RAD * px_per_rad)) ** 2)
    standing_out = (profile - np.median(profile)) * weights
    column = int(np.argmax(standing_out))
    prominence = float(standing_out[column])
    if prominence < _LEAST_PROMINENCE or not _is_clear(standing_out, column, max(2, round(_PEAK_RAD * px_per_rad))):
        return None
    right_px = float(rights_px[column]) + _peak_offset(profile[column - 1 : column + 2])
    return DoubtfulShift(_shift_of(right_px, 0.0, first.reaches.shape[0]), prominence)


def _shift_of(right_px: float, down_px: float, height: int) -> Shift:
    """Return a shift as points half way between the axes, from the upper part of the frames to the lower one."""
    rows_px = np.linspace(-_POINTS_REACH, _POINTS_REACH, _POINTS) * height
    half_px = np.full(_POINTS, right_px / 2)
    first_px = np.column_stack((half_px, rows_px + down_px / 2))
    return Shift(right_px, first_px, np.column_stack((-half_px, rows_px - down_px / 2)), "gradients", _SIGMA_PX)


def _correlations(
    first: Gradients, second: Gradients, expected_px: float, px_per_rad: float
) -> tuple[Array, Array, Array]:
    """Return the correlation (m, n) of shifts down (m,) and right (n,); -inf where the overlap is too small."""
    height, width = first.reaches.shape
    window_px, most_down_px = WINDOW_RAD * px_per_rad, math.floor(TILT_RAD * px_per_rad)
    rights_px = np.arange(math.ceil(expected_px - window_px), math.floor(expected_px + window_px) + 1)
    rights_px = rights_px[np.abs(rights_px) < width]
    downs_px = np.arange(-most_down_px, most_down_px + 1)
    if not len(rights_px):
        return np.empty((len(downs_px), 0)), rights_px, downs_px
    least_px, most_px = int(rights_px[0]), int(rights_px[-1])  # only the columns that can overlap
    first = _crop_columns(first, max(0, least_px), min(width, width + most_px))
    second = _crop_columns(second, max(0, -most_px), min(width, width - least_px))
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
    """Return whether no shift outside of the best one's peak is nearly as good; profile (n,)."""
    if not 0 < best < len(profile) - 1:
        return False
    is_far = np.abs(np.arange(len(profile)) - best) > reach
    rival, peak = float(profile[is_far].max(initial=-1.0)), float(profile[best])
    unlike = max(1 - peak, _LEAST_UNLIKE)
    return rival <= _CLEARLY_LESS * peak or 1 - rival >= _CLEARLY_MORE_UNLIKE * unlike


def _crop_columns(gradients: Gradients, first: int, end: int) -> Gradients:
    return Gradients(gradients.right[:, first:end], gradients.down[:, first:end], gradients.reaches[:, first:end])


def _structure(gradients: Gradients, right_px: float) -> float:
    """Return the strength of the gradients in the overlap with a frame whose axis is `right_px` to the right."""
    width = gradients.reaches.shape[1]
    columns = slice(max(0, round(right_px)), width + min(0, round(right_px)))
    number = float(gradients.reaches[:, columns].sum())
    if not number:
        return 0.0
    power = float((gradients.right[:, columns] ** 2 + gradients.down[:, columns] ** 2).sum())
    return math.sqrt(power / number)


def _peak_offset(scores: Array) -> float:
    """Return the position of a peak between its neighbours, by the parabola through the three."""
    before, peak, after = (float(score) for score in scores)
    bend = before - 2 * peak + after
    return (before - after) / (2 * bend) if math.isfinite(bend) and bend < 0 else 0.0
