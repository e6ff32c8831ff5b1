"""Detection of changes between two pictures from nearly the same place.

A robot never returns to a place exactly: pictures are shifted, and near objects more than far ones. So each spot of one
picture is searched for near the same spot of the other. A spot without a match belongs to an object that appeared or
disappeared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.kernel.errors import ArgumentError

Image = NDArray[np.uint8]
_Floats = NDArray[np.floating[Any]]

_WIDTH_PX: Final = 160  # width of the compared pictures: averaging many pixels removes noise
_SPOT_PX: Final = 7  # side of a spot, in pixels of that width
_MAD_TO_SIGMA: Final = 1.4826
_LEAST_GREY: Final = 9.0  # smallest difference of a spot in grey levels: smaller ones come from light and rounding
_SIGMAS: Final = 6.0
_SLACK_SHARE: Final = 0.04  # tolerated shift of unmoved objects, as a share of the width
_LEAST_SHARE: Final = 0.006  # smallest share of the picture of a reported change


@dataclass(frozen=True, slots=True)
class Changes:
    """Changes: their share of the picture, 0 to 1; and the box round each changed object, largest first.

    A box is x, y, width and height in pixels of the picture.
    """

    share: float
    boxes: tuple[tuple[int, int, int, int], ...]


def find_changes(before: Image, after: Image) -> Changes:
    """Return the objects that appeared or disappeared between two pictures, whose overall brightness may differ.

    They are RGB, (h, w, 3), at least 64 pixels wide and high, and of one shape; others raise ArgumentError.
    """
    if before.shape != after.shape:
        raise ArgumentError(f"pictures of one place must have one shape, not {before.shape} and {after.shape}")
    if before.ndim != 3 or before.shape[2] != 3 or min(before.shape[:2]) < 64:
        raise ArgumentError(f"a picture must be (h, w, 3) and at least 64 pixels wide and high, not {before.shape}")
    scale = before.shape[1] / _WIDTH_PX
    one, other = _shrink(before, scale), _shrink(after, scale)
    gain = float(np.median((other.mean(axis=2) + 1) / (one.mean(axis=2) + 1)))  # robust against changed objects
    one = np.asarray(np.minimum(one * gain, 255.0), np.float32)
    slack_px = max(1, math.ceil(_SLACK_SHARE * _WIDTH_PX))
    unlike = np.maximum(_dissimilarity(one, other, slack_px), _dissimilarity(other, one, slack_px))
    typical = float(np.median(unlike))
    spread = _MAD_TO_SIGMA * float(np.median(np.abs(unlike - typical)))
    mask = (unlike > typical + max(_LEAST_GREY, _SIGMAS * spread)).astype(np.uint8)
    for edge in (np.s_[:slack_px], np.s_[-slack_px:]):  # the other picture may not show the edges
        mask[edge, :] = mask[:, edge] = 0
    return _find_boxes(mask, scale, before.shape[1], before.shape[0])


def _shrink(image: Image, scale: float) -> _Floats:
    size = (_WIDTH_PX, max(1, round(image.shape[0] / scale)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR)
    return np.asarray(small, np.float32)


def _dissimilarity(one: _Floats, other: _Floats, slack_px: int) -> _Floats:
    """Return for each spot of a picture its difference, in grey levels, from the most similar spot near it.

    A level between a pixel's darkest and brightest neighbours counts as equal, because edges shift by fractions of a
    pixel.
    """
    height, width, _ = one.shape
    edge = cv2.copyMakeBorder(other, *(slack_px,) * 4, cv2.BORDER_REPLICATE)
    around = np.ones((3, 3), np.uint8)
    darkest, brightest = _planes(cv2.erode(edge, around)), _planes(cv2.dilate(edge, around))
    planes = _planes(one)
    best = np.full((height, width), np.inf, np.float32)
    for down in range(0, 2 * slack_px + 1, 2):  # the neighbours cover the skipped shifts
        for right in range(0, 2 * slack_px + 1, 2):
            here = np.s_[:, down : down + height, right : right + width]
            beyond = np.maximum(planes - brightest[here], darkest[here] - planes).max(axis=0)
            np.minimum(best, cv2.blur(np.maximum(beyond, 0.0), (_SPOT_PX, _SPOT_PX)), out=best)
    return best


def _planes(image: NDArray[Any]) -> _Floats:
    """Return the colours of a picture one after the other, (3, h, w): the largest of three is found much faster."""
    return np.ascontiguousarray(image.transpose(2, 0, 1), np.float32)


def _find_boxes(mask: NDArray[np.uint8], scale: float, width: int, height: int) -> Changes:
    """Return the boxes of the marked areas, in pixels of the original picture."""
    number, _, figures, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    found = sorted((tuple(map(int, figures[label])) for label in range(1, number)), key=lambda figure: -figure[4])
    large = [figure for figure in found if figure[4] >= _LEAST_SHARE * mask.size]
    boxes = []
    for left, top, wide, high, _ in large:
        x, y = int(left * scale), int(top * scale)
        boxes.append((x, y, min(math.ceil(wide * scale), width - x), min(math.ceil(high * scale), height - y)))
    return Changes(sum(figure[4] for figure in large) / mask.size, tuple(boxes))
