"""Layers: a layer covers, in each of its columns, the rows between two edges."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
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

    @property
    def columns(self) -> slice:
        """Its columns."""
        return slice(self.first, self.first + len(self.tops))

    @cached_property
    def _edges(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Its upper and its lower edge in less precision, with which numpy is faster."""
        return self.tops.astype(np.float32), self.bottoms.astype(np.float32)

    @cached_property
    def _between(self) -> tuple[float, float]:
        """The lowest point of its upper edge and the highest of its lower edge: it covers all columns between them."""
        return float(self.tops.max()), float(self.bottoms.min())

    def paint(self, image: Image) -> None:
        """Paint it over an image."""
        height = image.shape[0]
        low, high = float(self.tops.min()), float(self.bottoms.max())
        rect = Rect(
            self.first, self.columns.stop, max(math.floor(low + 0.5), 0), min(math.floor(high + 0.5) + 1, height)
        )
        if rect.top >= rect.bottom or high - low < _THIN_PX:
            return
        target = image[rect.top : rect.bottom, self.columns]
        rows = _row_numbers(height)[rect.top : rect.bottom]
        if target.size > _SMALL:
            self._paint_large(target, rect, rows)
            return
        under = target.copy()
        self.fill(rect, target)
        self._blend(target, under, rows)

    def _paint_large(self, target: Image, rect: Rect, rows: NDArray[np.float32]) -> None:
        """Paint it, without blending the rows that it covers in all columns."""
        lowest_top, highest_bottom = self._between
        start = min(max(math.ceil(lowest_top + 0.5), rect.top), rect.bottom)
        end = max(min(math.floor(highest_bottom - 0.5) + 1, rect.bottom), start)
        first, last = start - rect.top, end - rect.top
        upper, whole, lower = target[:first], target[first:last], target[last:]
        under_upper, under_lower = upper.copy(), lower.copy()
        sides = [(side, share) for side, share in ((0, self.left_share), (-1, self.right_share)) if share < 1.0]
        under_sides = [whole[:, side].astype(np.float32) for side, _ in sides]
        self.fill(rect, target)
        for (side, share), under in zip(sides, under_sides, strict=True):
            whole[:, side] = under + (whole[:, side] - under) * np.float32(share) + np.float32(0.5)
        self._blend(upper, under_upper, rows[:first])
        self._blend(lower, under_lower, rows[last:])

    def _blend(self, target: Image, under: Image, rows: NDArray[np.float32]) -> None:
        """Blend some rows with their previous content by the covered share."""
        if len(target):
            share = self._share(rows)
            cv2.blendLinear(target, under, share, 1 - share, target)

    def _share(self, rows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the covered share of each pixel of some rows, (rows, columns), 0..1."""
        (tops, bottoms), (lowest_top, highest_bottom) = self._edges, self._between
        if highest_bottom >= rows[-1, 0] + 0.5:
            share = rows + 0.5 - tops
            np.minimum(share, 1.0, out=share)
        else:
            share = bottoms - rows
            np.minimum(share, 0.5, out=share)
            if lowest_top <= rows[0, 0] - 0.5:
                share += 0.5
            else:
                above = tops - rows
                share -= np.maximum(above, -0.5, out=above)
        np.maximum(share, 0.0, out=share)
        if self.left_share < 1.0:
            share[:, 0] *= self.left_share
        if self.right_share < 1.0:
            share[:, -1] *= self.right_share
        return share


@lru_cache(maxsize=8)
def _row_numbers(height: int) -> NDArray[np.float32]:
    """Return the numbers of an image's rows, (height, 1)."""
    return np.arange(height, dtype=np.float32)[:, np.newaxis]
