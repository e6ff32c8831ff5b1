"""What a surface looks like, at every distance."""

from __future__ import annotations

import math
from typing import Any, Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

Image: TypeAlias = NDArray[np.uint8]
"""Rows from the top, shape (height, width, 4): red, green, blue and an unused channel, with which OpenCV is faster."""

_STEP: Final = 32  # so that the distance of samples doubles five times at least, each time with one on either edge
PAD: Final = 4
"""How many more samples, like its outermost ones, a version of a texture has on each side."""

_SHARPNESS: Final = 0.3  # towards finer versions: each halving blurs a little more than it must
_HALVING: Final = np.array([0.25, 0.5, 0.25], dtype=np.float32)


def samples(size_m: float, per_m: float) -> int:
    """Return how many samples a texture has along a length: the first and the last lie on its edges."""
    return max(1, math.ceil(size_m * per_m / _STEP - 1e-9)) * _STEP + 1


class Texture:
    """An image that fills a rectangle, with coarser versions for views from afar.

    The versions are coarser along and across apart from each other, for a wall is seen aslant along its length only.
    They are made when they are first needed.

    Args:
        image: the finest version, its sides as `samples` counts them; its outermost samples lie on the edges.
        size_m: width and height of the rectangle.

    Attributes:
        per_m: samples in a metre, along and across.
        deepest: how often it can be halved, along and across.

    Thread: any.
    """

    def __init__(self, image: Image, size_m: tuple[float, float]) -> None:
        self.size_m: Final = size_m
        self.per_m: Final = (image.shape[1] - 1) / size_m[0], (image.shape[0] - 1) / size_m[1]
        self.deepest: Final = _halvings(image.shape[1] - 1), _halvings(image.shape[0] - 1)
        self._versions: dict[tuple[int, int], Image] = {(0, 0): _padded(image)}

    @property
    def finest(self) -> Image:
        """The image that it was made from."""
        return _bare(self._versions[0, 0])

    def level(self, samples_per_px: float, axis: int) -> int:
        """Return how often to halve along an axis (0 along, 1 across) where a pixel holds so many samples."""
        return min(max(round(math.log2(samples_per_px) - _SHARPNESS), 0), self.deepest[axis])

    def levels(self, samples_per_px: NDArray[np.float64], axis: int) -> NDArray[np.intp]:
        """Return the same for each of several pixels."""
        wanted = np.rint(np.log2(samples_per_px) - _SHARPNESS)
        return np.clip(wanted, 0, self.deepest[axis]).astype(np.intp)

    def version(self, along: int, across: int) -> Image:
        """Return the image, halved so often along and across, with PAD more samples on each side."""
        known = self._versions.get((along, across))
        if known is not None:
            return known
        if along:
            known = _halved(_bare(self.version(along - 1, across)))
        else:
            known = _halved(_bare(self.version(0, across - 1)).swapaxes(0, 1)).swapaxes(0, 1)
        return self._versions.setdefault((along, across), _padded(known))


def _padded(image: Image) -> Image:
    """Return an image with a margin: so what is drawn at an edge never looks beyond it, which OpenCV is slow at."""
    return np.asarray(cv2.copyMakeBorder(np.ascontiguousarray(image), *(PAD,) * 4, cv2.BORDER_REPLICATE), np.uint8)


def _bare(image: Image) -> Image:
    return image[PAD:-PAD, PAD:-PAD]


def _halvings(intervals: int) -> int:
    return (intervals & -intervals).bit_length() - 1


def _halved(image: NDArray[Any]) -> Image:
    """Return every second column, each with half of its neighbours."""
    smooth = cv2.filter2D(np.ascontiguousarray(image), -1, _HALVING[np.newaxis], borderType=cv2.BORDER_REFLECT_101)
    return np.ascontiguousarray(smooth[:, ::2], dtype=np.uint8)
