"""Layers: a layer covers, in each of its columns, the rows between two edges."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Final, NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from .texture import Image


class Rect(NamedTuple):
    """A part of an image: columns from `left` to before `right`, rows from `top` to before `bottom`."""

    left: int
    right: int
    top: int
    bottom: int


Fill: TypeAlias = Callable[[Rect, Image], None]
"""Writes the colours of a part of the image."""

Edge: TypeAlias = NDArray[np.float32]
"""The row of an edge in each column."""

_THIN_PX: Final = 0.05
_SMALL_PX: Final = 6000
"""Area above which rows that a layer covers in all columns are not blended."""
_WIDE_PX: Final = 256
"""Number of columns from which a layer is drawn in its place: a copy takes longer than the columns that are left."""
_STRIDE: Final = 16
"""OpenCV warps so many columns at once, and those that are left one by one, each in the time of four."""
_LARGE_PX: Final = 2500
"""Area from which bytes are blended in four steps: `blendLinear` divides in each pixel, and a call takes less time."""

_ONE: Final = np.array(1.0, np.float32)
"""As an array, which numpy takes in half the time of a number."""


class Layer(NamedTuple):
    """The area of an image that a surface covers.

    A pixel spans half a pixel to each side of its centre. The edges may be anywhere: a partly covered pixel is blended.

    Attributes:
        first: its first column.
        tops: upper edge in each column.
        bottoms: lower edge in each column.
        extent: the least and the greatest row of its upper edge, and those of its lower edge.
        fill: writes its colours.
        left_share: covered share of its first column, 0..1.
        right_share: covered share of its last column, 0..1.
    """

    first: int
    tops: Edge
    bottoms: Edge
    extent: tuple[float, float, float, float]
    fill: Fill
    left_share: float = 1.0
    right_share: float = 1.0

    def paint(self, image: Image) -> None:
        """Paint it over an image."""
        first, columns, (low, lowest_top, highest_bottom, high) = self.first, len(self.tops), self.extent
        top, bottom = max(math.floor(low + 0.5), 0), min(math.floor(high + 0.5) + 1, len(image))
        if top >= bottom or high - low < _THIN_PX:
            return
        target = image[top:bottom, first : first + columns]
        is_wide = columns >= _WIDE_PX
        colours = target if is_wide else np.empty((bottom - top, padded(columns), 4), np.uint8)
        rect = Rect(first, first + colours.shape[1], top, bottom)
        if not is_wide and (bottom - top) * columns <= _SMALL_PX:
            self.fill(rect, colours)
            self._blend(target, colours[:, :columns], target, top)
            return
        start = min(max(math.ceil(lowest_top + 0.5), top), bottom)  # of the rows that it covers in all columns
        end = max(min(math.floor(highest_bottom - 0.5) + 1, bottom), start)
        bands = [slice(0, start - top), slice(end - top, bottom - top)]
        unders = [target[band].copy() if is_wide else target[band] for band in bands]
        whole = target[start - top : end - top]
        edges = ((0, self.left_share), (columns - 1, self.right_share))
        sides = [(whole[:, at : at + 1], share) for at, share in edges if share < 1.0]
        side_unders = [side.copy() for side, _ in sides]
        self.fill(rect, colours)
        if not is_wide:
            whole[:] = colours[start - top : end - top, :columns]
        for (side, share), under in zip(sides, side_unders, strict=True):
            cv2.addWeighted(side, share, under, 1 - share, 0.0, side)
        for band, under in zip(bands, unders, strict=True):
            self._blend(target[band], colours[band, :columns], under, top + band.start)

    def _blend(self, target: Image, colours: Image, under: Image, top: int) -> None:
        """Blend some rows, from row `top` on, with their previous content by the covered share."""
        if not len(target):
            return
        last = top + len(target)
        limits = np.maximum(_row_limits(last.bit_length())[top : last + 1], self.tops)
        np.minimum(limits, self.bottoms, out=limits)
        share = np.subtract(limits[1:], limits[:-1])
        if self.left_share < 1.0:
            share[:, 0] *= self.left_share
        if self.right_share < 1.0:
            share[:, -1] *= self.right_share
        if share.size < _LARGE_PX:
            cv2.blendLinear(colours, under, share, np.subtract(_ONE, share), target)
            return
        weights = cv2.cvtColor(cv2.convertScaleAbs(share, alpha=255), cv2.COLOR_GRAY2RGBA)
        rest = cv2.multiply(under, cv2.bitwise_not(weights), scale=1 / 255)
        cv2.add(cv2.multiply(colours, weights, scale=1 / 255), rest, target)


def padded(columns: int) -> int:
    """Return the least number of columns, at least a given one, that OpenCV warps without a rest."""
    return -(-columns // _STRIDE) * _STRIDE


@lru_cache(maxsize=8)
def _row_limits(bits: int) -> NDArray[np.float32]:
    """Return where the rows below 2**bits begin, and the last one ends, (rows + 1, 1)."""
    return np.arange(2**bits + 1, dtype=np.float32)[:, np.newaxis] - np.float32(0.5)
