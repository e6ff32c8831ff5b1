"""Layers: a layer covers, in each of its columns, the rows between two edges."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
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


_THIN_PX: Final = 0.05
_SMALL_PX: Final = 4000
"""Area above which rows that a layer covers in all columns are not blended."""
_WIDE_PX: Final = 256
"""Number of columns from which a layer is drawn in its place: a copy takes longer than the columns that are left."""
_STRIDE: Final = 16
"""OpenCV warps so many columns at once, and those that are left one by one, each in the time of four."""


_ZERO, _HALF, _ONE = (np.array(number, np.float32) for number in (0.0, 0.5, 1.0))
"""As arrays, which numpy takes in half the time of a number."""


@dataclass
class Layer:
    """The area of an image that a surface covers.

    A pixel spans half a pixel to each side of its centre. The edges may be anywhere: a partly covered pixel is blended.

    Attributes:
        first: its first column.
        tops: upper edge in each column.
        bottoms: lower edge in each column.
        fill: writes its colours.
        left_share: covered share of its first column, 0..1.
        right_share: covered share of its last column, 0..1.
    """

    first: int
    tops: NDArray[np.float64]
    bottoms: NDArray[np.float64]
    fill: Fill
    left_share: float = 1.0
    right_share: float = 1.0
    columns: slice = field(init=False)

    def __post_init__(self) -> None:
        self.columns = slice(self.first, self.first + len(self.tops))


def paint(image: Image, layers: Sequence[Layer]) -> None:
    """Paint layers over an image, one over the other.

    What has to be known of their edges is found for all together: a step of numpy takes as long for one layer.
    """
    starts = [0, *itertools.accumulate(len(layer.tops) for layer in layers)]
    size = starts.pop()
    if not size:
        return
    tops, bottoms = (np.concatenate(edges) for edges in zip(*((it.tops, it.bottoms) for it in layers), strict=True))
    extents = zip(
        np.minimum.reduceat(tops, starts).tolist(),
        np.maximum.reduceat(tops, starts).tolist(),
        np.minimum.reduceat(bottoms, starts).tolist(),
        np.maximum.reduceat(bottoms, starts).tolist(),
        strict=True,
    )
    fine_tops, fine_bottoms = tops.astype(np.float32), bottoms.astype(np.float32)  # numpy is faster with them
    for layer, start, extent in zip(layers, starts, extents, strict=True):
        part = slice(start, start + len(layer.tops))
        _LayerPainter(layer, fine_tops[part], fine_bottoms[part], extent).paint(image)


class _LayerPainter:
    """Paints a layer.

    Args:
        tops: its upper edge.
        bottoms: its lower edge.
        extent: the least and the greatest row of its upper edge, and those of its lower edge.
    """

    def __init__(
        self,
        layer: Layer,
        tops: NDArray[np.float32],
        bottoms: NDArray[np.float32],
        extent: tuple[float, float, float, float],
    ) -> None:
        self._layer, self._tops, self._bottoms, self._extent = layer, tops, bottoms, extent
        left, right = layer.left_share, layer.right_share
        self._is_cut = left < 1.0 or right < 1.0
        """Whether it covers its outermost columns in part."""
        if self._is_cut:
            is_one = len(tops) == 1
            self._sides = slice(None) if is_one else slice(None, None, len(tops) - 1)
            self._shares = np.array([left * right] if is_one else [left, right], np.float32)

    def paint(self, image: Image) -> None:
        """Paint it over an image."""
        layer, columns = self._layer, len(self._tops)
        low, lowest_top, highest_bottom, high = self._extent
        top, bottom = max(math.floor(low + 0.5), 0), min(math.floor(high + 0.5) + 1, image.shape[0])
        if top >= bottom or high - low < _THIN_PX:
            return
        target, rows = image[top:bottom, layer.columns], bottom - top
        is_wide = columns >= _WIDE_PX
        width = columns if is_wide else padded(columns)
        colours = target if is_wide else np.empty((rows, width, 4), np.uint8)
        rect = Rect(layer.first, layer.first + width, top, bottom)
        if rows * columns <= _SMALL_PX and not is_wide:
            layer.fill(rect, colours)
            self._blend(target, colours[:, :columns], target, top)
            return
        start = min(max(math.ceil(lowest_top + 0.5), top), bottom)
        end = max(min(math.floor(highest_bottom - 0.5) + 1, bottom), start)
        upper, whole, lower = slice(start - top), slice(start - top, end - top), slice(end - top, None)
        unders = [target[upper], target[lower]]
        if is_wide:
            unders = [under.copy() for under in unders]
        under_sides = target[whole, self._sides].astype(np.float32) if self._is_cut else None
        layer.fill(rect, colours)
        colours = colours[:, :columns]
        if not is_wide:
            target[whole] = colours[whole]
        if under_sides is not None:
            sides = colours[whole, self._sides] - under_sides
            target[whole, self._sides] = under_sides + sides * self._shares[:, np.newaxis] + _HALF
        for part, under, first in ((upper, unders[0], top), (lower, unders[1], end)):
            self._blend(target[part], colours[part], under, first)

    def _blend(self, target: Image, colours: Image, under: Image, top: int) -> None:
        """Blend some rows, from row `top` on, with their previous content by the covered share."""
        if not len(target):
            return
        begins, ends = _row_limits((bottom := top + len(target)).bit_length())
        share = np.minimum(ends[top:bottom], self._bottoms)
        share -= np.maximum(begins[top:bottom], self._tops)
        np.maximum(share, _ZERO, out=share)
        if self._is_cut:
            share[:, self._sides] *= self._shares
        cv2.blendLinear(colours, under, share, np.subtract(_ONE, share), target)


def padded(columns: int) -> int:
    """Return the least number of columns, at least a given one, that OpenCV warps without a rest."""
    return -(-columns // _STRIDE) * _STRIDE


@lru_cache(maxsize=8)
def _row_limits(bits: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return where the rows below 2**bits begin and end, (rows, 1) each."""
    rows = np.arange(2**bits, dtype=np.float32)[:, np.newaxis]
    return rows - _HALF, rows + _HALF
