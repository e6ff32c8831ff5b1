"""Corners of markers to a few hundredths of a pixel: lines are fitted to the four sides, and intersected.

`cv2.cornerSubPix` is made for the saddles of a chessboard: at the corner of a small black square it sometimes fails by
two or three pixels. The sides have ten times as many pixels, so their lines are more exact.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from .lens import Floats

_POINTS: Final = 14  # along a side
_ENDS: Final = 0.12  # share of a side at both ends that blur has rounded
_SAMPLES: Final = 15  # across a side
_REACH_CELLS: Final = 0.75
_LEAST_REACH_PX, _MOST_REACH_PX = 2.0, 5.0
_LEAST_CONTRAST: Final = 15.0
_OUTLIER_PX: Final = 0.7
_ROUNDS: Final = 2


def refine(grey: NDArray[np.uint8], corners: Floats, cells: int) -> Floats:
    """Return exact corners of dark squares on a bright ground.

    Args:
        grey: the picture, (height, width).
        corners: approximate, clockwise as they are seen, (n, 4, 2).
        cells: of a marker along a side; neighbouring edges are one cell away.
    """
    bright = grey.astype(np.float32)
    for _ in range(_ROUNDS):
        corners = _intersected(corners, *_side_offsets(bright, corners, cells))
    return corners


def _side_offsets(bright: NDArray[np.float32], corners: Floats, cells: int) -> tuple[Floats, Floats]:
    """Return by how much each side lies farther outside at its start and at its end, (n, 4) each, in pixels."""
    ways = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(ways, axis=2)
    reach = np.clip(lengths.mean(axis=1) / cells * _REACH_CELLS, _LEAST_REACH_PX, _MOST_REACH_PX)
    shares = np.linspace(_ENDS, 1 - _ENDS, _POINTS)
    points = corners[:, :, np.newaxis] + shares[:, np.newaxis] * ways[:, :, np.newaxis]
    across = np.linspace(-1, 1, _SAMPLES) * reach[:, np.newaxis]  # (n, samples)
    places = (
        points[..., np.newaxis, :]
        + across[:, np.newaxis, np.newaxis, :, np.newaxis] * (_outwards(corners)[:, :, np.newaxis, np.newaxis])
    )
    flat = places.reshape(-1, _SAMPLES, 2).astype(np.float32)
    values = cv2.remap(bright, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    rises = np.maximum(np.diff(np.asarray(values, np.float64), axis=1), 0).reshape(*places.shape[:3], _SAMPLES - 1)
    middles = (across[:, 1:] + across[:, :-1])[:, np.newaxis, np.newaxis] / 2
    squares = rises**2
    edges = (squares * middles).sum(axis=-1) / np.maximum(squares.sum(axis=-1), 1e-9)
    weights = (rises.sum(axis=-1) > _LEAST_CONTRAST).astype(np.float64)
    start, slope = _lines(shares, edges, weights)
    away = np.abs(edges - start[..., np.newaxis] - slope[..., np.newaxis] * shares)
    start, slope = _lines(shares, edges, weights * (away < _OUTLIER_PX))
    return start, start + slope


def _lines(shares: Floats, edges: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return start and slope of the least squares line through each side's edges; 0 where there are too few."""
    total = weights.sum(axis=-1)
    is_fit = total >= _POINTS / 2
    total = np.where(is_fit, total, 1.0)
    mean_share, mean_edge = (weights * shares).sum(axis=-1) / total, (weights * edges).sum(axis=-1) / total
    apart = shares - mean_share[..., np.newaxis]
    spread = (weights * apart**2).sum(axis=-1)
    slope = (weights * apart * edges).sum(axis=-1) / np.where(is_fit, spread, 1.0)
    return np.where(is_fit, mean_edge - slope * mean_share, 0.0), np.where(is_fit, slope, 0.0)


def _outwards(corners: Floats) -> Floats:
    """Return the unit vector out of the square for each side, (n, 4, 2)."""
    ways = np.roll(corners, -1, axis=1) - corners
    ways = ways / np.maximum(np.linalg.norm(ways, axis=2, keepdims=True), 1e-9)
    return np.stack([ways[..., 1], -ways[..., 0]], axis=-1)


def _intersected(corners: Floats, starts: Floats, ends: Floats) -> Floats:
    """Return the corners where the moved sides intersect."""
    out = _outwards(corners)
    first = corners + starts[..., np.newaxis] * out
    last = np.roll(corners, -1, axis=1) + ends[..., np.newaxis] * out
    ways = last - first
    before_first, before_ways = np.roll(first, 1, axis=1), np.roll(ways, 1, axis=1)
    apart = first - before_first
    cross = before_ways[..., 0] * ways[..., 1] - before_ways[..., 1] * ways[..., 0]
    share = (apart[..., 0] * ways[..., 1] - apart[..., 1] * ways[..., 0]) / np.where(
        np.abs(cross) > 1e-9, cross, np.inf
    )
    return np.asarray(before_first + share[..., np.newaxis] * before_ways)
