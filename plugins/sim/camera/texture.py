"""Mipmaps: images of surfaces at several resolutions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

Image: TypeAlias = NDArray[np.uint8]
"""Rows from the top, shape (height, width, 4): red, green, blue and an unused channel, with which OpenCV is faster."""

_BLOCK: Final = 128  # rows
_STEP: Final = 32  # allows at least five halvings, each with a sample on both edges
PAD: Final = 4
"""Border of a version of a mipmap: copies of its outermost samples on each side."""

_SHARPNESS: Final = 0.3  # bias towards finer versions: each halving blurs a little too much
_HALVING: Final = np.array([0.25, 0.5, 0.25], dtype=np.float32)


def samples(size_m: float, per_m: float) -> int:
    """Return the number of samples along a length; the first and the last lie on the edges."""
    return max(1, math.ceil(size_m * per_m / _STEP - 1e-9)) * _STEP + 1


def row_blocks(rows: int) -> Iterator[slice]:
    """Yield slices of an image's rows. A robot with 256 MB of RAM has no room for several arrays of a whole floor."""
    for start in range(0, rows, _BLOCK):
        yield slice(start, min(start + _BLOCK, rows))


class Mipmap:
    """An image that fills a rectangle, with coarser versions for distant views.

    The resolutions along and across are independent, because a wall is foreshortened along its length only. They
    are created on first use.

    Args:
        image: the finest version, with side lengths from `samples`; its outermost samples lie on the edges.
        size_m: width and height of the rectangle.

    Attributes:
        per_m: samples per metre, along and across.
        deepest: the number of possible halvings, along and across.

    Thread: any.
    """

    def __init__(self, image: Image, size_m: tuple[float, float]) -> None:
        self.size_m: Final = size_m
        self.per_m: Final = (image.shape[1] - 1) / size_m[0], (image.shape[0] - 1) / size_m[1]
        self.deepest: Final = _count_halvings(image.shape[1] - 1), _count_halvings(image.shape[0] - 1)
        self._versions: dict[tuple[int, int], Image] = {(0, 0): _pad(image)}

    @property
    def finest(self) -> Image:
        """The original image."""
        return _unpad(self._versions[0, 0])

    def level(self, samples_per_px: float, axis: int) -> int:
        """Return the number of halvings along an axis (0 along, 1 across) for a sample density."""
        return min(max(round(math.log2(samples_per_px) - _SHARPNESS), 0), self.deepest[axis])

    @staticmethod
    def most(level: int) -> float:
        """Return the sample density up to which `level` returns a number of halvings, if there are that many."""
        return float(2 ** (level + 0.5 + _SHARPNESS))

    def version(self, along: int, across: int) -> Image:
        """Return the image after some halvings along and across, with a border of PAD samples."""
        known = self._versions.get((along, across))
        if known is not None:
            return known
        if along:
            known = _halve(_unpad(self.version(along - 1, across)))
        else:
            known = _halve(_unpad(self.version(0, across - 1)).swapaxes(0, 1)).swapaxes(0, 1)
        return self._versions.setdefault((along, across), _pad(known))


def halvings(samples_per_px: NDArray[np.float64], deepest: int) -> NDArray[np.intp]:
    """Return the number of halvings, at most `deepest`, for each of several sample densities."""
    wanted = np.rint(np.log2(samples_per_px) - _SHARPNESS)
    return np.minimum(np.maximum(wanted, 0.0), deepest).astype(np.intp)


def _pad(image: Image) -> Image:
    """Return an image with a border. OpenCV is slow at sampling beyond the edge of an image."""
    return np.asarray(cv2.copyMakeBorder(np.ascontiguousarray(image), *(PAD,) * 4, cv2.BORDER_REPLICATE), np.uint8)


def _unpad(image: Image) -> Image:
    return image[PAD:-PAD, PAD:-PAD]


def _count_halvings(intervals: int) -> int:
    return (intervals & -intervals).bit_length() - 1


def _halve(image: NDArray[Any]) -> Image:
    """Return every second column, smoothed with its neighbours."""
    smooth = cv2.filter2D(np.ascontiguousarray(image), -1, _HALVING[np.newaxis], borderType=cv2.BORDER_REFLECT_101)
    return np.ascontiguousarray(smooth[:, ::2], dtype=np.uint8)
