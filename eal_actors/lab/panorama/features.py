"""Offset of two frames by the vote of matching SIFT features."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.lab.panorama.cylinder import TILT_RAD, WINDOW_RAD, Shift
from eal_actors.lab.panorama.patches import Patch

_MOST: Final = 1500
_CONTRAST: Final = 0.02  # half of the usual threshold of SIFT: walls of rooms have little contrast
_RATIO: Final = 0.85
_SAME_RAD: Final = 0.0055  # largest difference between pairs that agree, for things at several distances
_ALIKE_RAD: Final = 0.03  # the same for a lens that is not known yet
_SIGMA_PX: Final = 0.2
_ENOUGH: Final = 150  # points of a pair of frames
_FEWEST: Final = 8
_LEAST_SHARE: Final = 0.2
_RIVAL_SHARE: Final = 0.6
"""A second shift with more than this share of the votes makes the result ambiguous: a repeating pattern."""
_EDGE_PX: Final = 6

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Features:
    """Features of a frame: their places, and their looks, which are descriptors of unit length, (n, 128).

    The places are offsets from the axis to the right and down, in pixels of the cylinder, (n, 2).
    """

    places: Array
    looks: Array


def find_features(patch: Patch) -> Features:
    """Return the features of a frame."""
    kernel = np.ones((2 * _EDGE_PX + 1,) * 2, np.uint8)
    padded = cv2.copyMakeBorder(patch.reaches.astype(np.uint8), *(1,) * 4, cv2.BORDER_CONSTANT, value=0)
    inner = np.ascontiguousarray(cv2.erode(padded, kernel)[1:-1, 1:-1])
    sift = cv2.SIFT.create(nfeatures=_MOST, contrastThreshold=_CONTRAST)
    found, looks = sift.detectAndCompute(patch.grey, inner)
    if looks is None:
        return Features(np.empty((0, 2)), np.empty((0, 128), np.float32))
    lengths = np.linalg.norm(looks, axis=1, keepdims=True)
    places = np.array([point.pt for point in found]) - patch.centre_px
    return Features(places, looks / np.maximum(lengths, 1e-6))


def shift_by_features(
    first: Features, second: Features, expected_px: float, px_per_rad: float, *, window_rad: float = WINDOW_RAD
) -> Shift | None:
    """Return the offset of two frames, or None if too few pairs agree or the result is ambiguous.

    By odometry, wrong by at most `window_rad`, the second frame is `expected_px` to the right of the first.
    """
    window_px = window_rad * px_per_rad
    first = _within_reach(first, second, expected_px, window_px)
    second = _within_reach(second, first, -expected_px, window_px)
    kept, partner = _matches(first, second, expected_px, window_px, TILT_RAD * px_per_rad)
    if len(kept) < _FEWEST:
        return None
    first_px, second_px = first.places[kept], second.places[partner]
    pairs = first_px - second_px
    same_px = max(1.5, _SAME_RAD * px_per_rad)
    agree = np.linalg.norm(pairs[:, np.newaxis] - pairs, axis=2) <= same_px
    votes = agree.sum(axis=1)
    best = int(np.argmax(votes))
    is_far = np.linalg.norm(pairs - pairs[best], axis=1) > 3 * same_px
    rival = int(votes[is_far].max(initial=0))
    if votes[best] < max(_FEWEST, _LEAST_SHARE * len(pairs)) or rival > _RIVAL_SHARE * votes[best]:
        return None
    alike = np.flatnonzero(np.linalg.norm(pairs - pairs[best], axis=1) <= max(1.5, _ALIKE_RAD * px_per_rad))
    alike = alike[:: 1 + len(alike) // _ENOUGH]
    return Shift(float(pairs[agree[best], 0].mean()), first_px[alike], second_px[alike], "features", _SIGMA_PX)


def _within_reach(features: Features, others: Features, expected_px: float, window_px: float) -> Features:
    """Return the features within reach of some other one, whose axis is expected at an offset to the right."""
    if not len(features.places) or not len(others.places):
        return features
    right_px, others_px = features.places[:, 0], others.places[:, 0] + expected_px
    kept = (right_px >= others_px.min() - window_px) & (right_px <= others_px.max() + window_px)
    return Features(features.places[kept], features.looks[kept])


def _matches(
    first: Features, second: Features, expected_px: float, window_px: float, tilt_px: float
) -> tuple[Array, Array]:
    """Return the numbers of the matching features of both frames, (n,) each.

    Only pairs that odometry allows are compared, so that an identical tile a metre away does no harm.
    """
    if not len(first.places) or not len(second.places):
        return np.empty(0, int), np.empty(0, int)
    right_px = first.places[:, np.newaxis, 0] - second.places[:, 0]
    down_px = first.places[:, np.newaxis, 1] - second.places[:, 1]
    is_allowed = np.abs(right_px - expected_px) <= window_px
    is_allowed &= np.abs(down_px) <= tilt_px
    unlike = np.where(is_allowed, np.sqrt(np.maximum(2 - 2 * first.looks @ second.looks.T, 0)), np.inf)
    partner = unlike.argmin(axis=1)
    row = np.arange(len(unlike))
    nearest = unlike[row, partner]
    is_mutual = unlike.argmin(axis=0)[partner] == row
    others = unlike.copy()
    is_near = np.linalg.norm(second.places[partner][:, np.newaxis] - second.places, axis=2) < _EDGE_PX / 2
    others[is_near] = np.inf  # one place may have several features of different orientation
    is_clear = nearest < _RATIO * np.minimum(others.min(axis=1), 1.2)
    kept = np.flatnonzero(is_mutual & is_clear & np.isfinite(nearest))
    return kept, partner[kept]
