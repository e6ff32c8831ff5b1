"""Layers: a layer covers, in each of its columns, the rows between two edges."""

from __future__ import annotations

import math
from collections.abc import Callable
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
_SMALL: Final = 4 * 8000  # bytes: above this size, fully covered rows are not blended


_ZERO, _HALF, _ONE, _MINUS_HALF = (np.array(number, np.float32) for number in (0.0, 0.5, 1.0, -0.5))
"""As arrays, which numpy takes in half the time of a number."""
_least, _most = np.minimum.reduce, np.maximum.reduce


class _Edges(NamedTuple):
    """The edges of a layer in less precision, with which numpy is faster.

    Attributes:
        lowest_top: the lowest point of its upper edge.
        highest_bottom: the highest of its lower edge: the layer covers all columns between the two.
    """

    tops: NDArray[np.float32]
    bottoms: NDArray[np.float32]
    lowest_top: float
    highest_bottom: float


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
        columns: its columns.
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

    def paint(self, image: Image) -> None:
        """Paint it over an image."""
        height = image.shape[0]
        low, high = float(_least(self.tops)), float(_most(self.bottoms))
        rect = Rect(
            self.first, self.columns.stop, max(math.floor(low + 0.5), 0), min(math.floor(high + 0.5) + 1, height)
        )
        if rect.top >= rect.bottom or high - low < _THIN_PX:
            return
        target = image[rect.top : rect.bottom, self.columns]
        edges = _Edges(
            self.tops.astype(np.float32),
            self.bottoms.astype(np.float32),
            float(_most(self.tops)),
            float(_least(self.bottoms)),
        )
        if target.size > _SMALL:
            self._paint_large(target, rect, edges)
            return
        under = target.copy()
        self.fill(rect, target)
        self._blend(target, under, rect.top, edges)

    def _paint_large(self, target: Image, rect: Rect, edges: _Edges) -> None:
        """Paint it, without blending the rows that it covers in all columns."""
        start = min(max(math.ceil(edges.lowest_top + 0.5), rect.top), rect.bottom)
        end = max(min(math.floor(edges.highest_bottom - 0.5) + 1, rect.bottom), start)
        first, last = start - rect.top, end - rect.top
        upper, whole, lower = target[:first], target[first:last], target[last:]
        under_upper, under_lower = upper.copy(), lower.copy()
        sides = [(side, share) for side, share in ((0, self.left_share), (-1, self.right_share)) if share < 1.0]
        under_sides = [whole[:, side].astype(np.float32) for side, _ in sides]
        self.fill(rect, target)
        for (side, share), under in zip(sides, under_sides, strict=True):
            whole[:, side] = under + (whole[:, side] - under) * np.float32(share) + np.float32(0.5)
        self._blend(upper, under_upper, rect.top, edges)
        self._blend(lower, under_lower, end, edges)

    def _blend(self, target: Image, under: Image, top: int, edges: _Edges) -> None:
        """Blend some rows, from row `top` on, with their previous content by the covered share."""
        if len(target):
            share = self._share(top, top + len(target), edges)
            cv2.blendLinear(target, under, share, np.subtract(_ONE, share), target)

    def _share(self, top: int, bottom: int, edges: _Edges) -> NDArray[np.float32]:
        """Return the covered share of each pixel of some rows, (rows, columns), 0..1."""
        rows = _row_numbers(bottom.bit_length())[top:bottom]
        if edges.highest_bottom >= bottom - 0.5:
            share = rows + _HALF - edges.tops
            np.minimum(share, _ONE, out=share)
        else:
            share = edges.bottoms - rows
            np.minimum(share, _HALF, out=share)
            if edges.lowest_top <= top - 0.5:
                share += _HALF
            else:
                above = edges.tops - rows
                share -= np.maximum(above, _MINUS_HALF, out=above)
        np.maximum(share, _ZERO, out=share)
        if self.left_share < 1.0:
            share[:, 0] *= self.left_share
        if self.right_share < 1.0:
            share[:, -1] *= self.right_share
        return share


@lru_cache(maxsize=8)
def _row_numbers(bits: int) -> NDArray[np.float32]:
    """Return the numbers of the rows below 2**bits, (rows, 1)."""
    return np.arange(2**bits, dtype=np.float32)[:, np.newaxis]
