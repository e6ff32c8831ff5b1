"""Painting: a layer covers, in each of its columns, the rows between two edges."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
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


Fill: TypeAlias = Callable[[Rect], Image]
"""Makes the colours of a part of the image."""


_THIN_PX: Final = 0.05
_SMALL: Final = 4 * 8000  # numbers: from here on it is worth while to copy what is covered whole


@dataclass
class Layer:
    """What a surface covers of an image.

    A pixel spans half a pixel to each side of its number, so the edges may be anywhere; a pixel that is covered in
    part is painted in part.

    Attributes:
        first: its first column.
        tops: upper edge in each column.
        bottoms: lower edge in each column.
        fill: makes its colours.
        left_share: how much of its first column it covers, 0..1.
        right_share: how much of its last column it covers, 0..1.
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

    def paint(self, image: Image) -> None:
        """Paint it over an image."""
        height = image.shape[0]
        low, high = float(self.tops.min()), float(self.bottoms.max())
        rect = Rect(
            self.first, self.columns.stop, max(math.floor(low + 0.5), 0), min(math.floor(high + 0.5) + 1, height)
        )
        if rect.top >= rect.bottom or high - low < _THIN_PX:
            return
        colours = self.fill(rect)
        target = image[rect.top : rect.bottom, self.columns]
        start, end = rect.top, rect.top
        if colours.size > _SMALL:
            start = min(max(math.ceil(float(self.tops.max()) + 0.5), rect.top), rect.bottom)
            end = max(min(math.floor(float(self.bottoms.min()) - 0.5) + 1, rect.bottom), start)
        if end > start:
            self._paint_full(target[start - rect.top : end - rect.top], colours[start - rect.top : end - rect.top])
        for top, bottom in ((rect.top, start), (end, rect.bottom)):
            if top < bottom:
                part = slice(top - rect.top, bottom - rect.top)
                self._paint_partly(target[part], colours[part], top)

    def _paint_full(self, target: Image, colours: Image) -> None:
        """Paint rows that it covers in all its columns."""
        target[:, 1:-1] = colours[:, 1:-1]
        for side, share in ((0, self.left_share), (-1, self.right_share)):
            mix = target[:, side] + (colours[:, side].astype(np.float32) - target[:, side]) * share
            target[:, side] = (mix + 0.5).astype(np.uint8)

    def _paint_partly(self, target: Image, colours: Image, first_row: int) -> None:
        """Paint each pixel of some rows as far as it is covered."""
        rows = np.arange(first_row, first_row + len(target), dtype=np.float32)[:, np.newaxis]
        above, below = self.bottoms.astype(np.float32) - rows, self.tops.astype(np.float32) - rows
        share = np.minimum(above, 0.5, out=above)
        share -= np.maximum(below, -0.5, out=below)
        np.maximum(share, 0.0, out=share)
        share[:, 0] *= self.left_share
        share[:, -1] *= self.right_share
        cv2.blendLinear(colours, target, share, 1 - share, target)
