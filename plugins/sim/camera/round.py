"""Drums: each column of the image meets a drum's side at one distance, so it is drawn column by column."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from .eye import NEAR_M, Eye
from .flat import UNDERLAP_PX, fill_plane
from .layers import Layer, Rect
from .solids import Drum, Tower
from .texture import PAD, Image

_WIDEST_RAD = math.radians(89.0)


@dataclass(frozen=True)
class _Outline:
    """The outline of a drum in the image: its columns, and the distances ahead of its front and back in them.

    `facing` tells where the side faces there, counter-clockwise from the x axis, in turns, -0.5..0.5.
    """

    first: int
    near_m: NDArray[np.float64]
    far_m: NDArray[np.float64]
    facing: NDArray[np.float64]
    shares: tuple[float, float]


def tower_layers(eye: Eye, tower: Tower) -> list[Layer]:
    """Return the layers of a tower in painting order."""
    return list(_stacked(eye, tower.drums))


def _stacked(eye: Eye, drums: tuple[Drum, ...]) -> Iterator[Layer]:
    drum, *above = drums
    outline = _outline(eye, drum)
    if outline and eye.z_m > drum.height_m:
        yield _top(eye, drum, outline)
    if above:  # it hides the side of the drum below or is hidden by it
        yield from _stacked(eye, tuple(above))
    if outline:
        yield _side(eye, drum, outline)


def _outline(eye: Eye, drum: Drum) -> _Outline | None:
    right_m, ahead_m = eye.seen(drum.middle)
    distance_m = math.hypot(right_m, ahead_m)
    if distance_m <= drum.radius_m:
        return None
    bearing, half = math.atan2(right_m, ahead_m), math.asin(drum.radius_m / distance_m)
    if bearing - half >= _WIDEST_RAD or bearing + half <= -_WIDEST_RAD:
        return None
    slopes = [math.tan(max(-_WIDEST_RAD, min(_WIDEST_RAD, bearing + sign * half))) for sign in (-1, 1)]
    left, right = (eye.column(slope, 1.0) for slope in slopes)
    end = eye.lens.width - 0.5
    if right <= -0.5 or left >= end:
        return None
    first, last = math.floor(max(left, 0.0) + 0.5), math.floor(min(right, end - 0.5) + 0.5)
    rays = eye.slopes[first : last + 1].copy()
    for side in (0, -1):  # only the centres of these columns may be beyond the outline
        rays[side] = min(max(rays[side], slopes[0]), slopes[1])
    square = 1 + rays**2
    middle = (ahead_m + rays * right_m) / square
    half_chord = np.sqrt(np.maximum(middle**2 - (distance_m**2 - drum.radius_m**2) / square, 0.0))
    near_m = np.maximum(middle - half_chord, NEAR_M)
    hits = [
        near_m * (ahead + rays * right) + (eye_m - middle_m)
        for ahead, right, eye_m, middle_m in zip(eye.ahead, eye.right, (eye.x_m, eye.y_m), drum.middle, strict=True)
    ]
    return _Outline(
        first,
        near_m,
        np.maximum(middle + half_chord, near_m),
        np.arctan2(hits[1], hits[0]) / (2 * math.pi),
        (1.0 if left < -0.5 else first + 0.5 - left, 1.0 if right > end else min(1.0, right - max(last - 0.5, left))),
    )


def _top(eye: Eye, drum: Drum, outline: _Outline) -> Layer:
    tops, bottoms = (eye.rows(drum.height_m, 1 / ahead_m) for ahead_m in (outline.far_m, outline.near_m))
    bottoms += UNDERLAP_PX
    return Layer(
        outline.first, tops, bottoms, lambda rect, target: fill_plane(eye, drum.top, rect, target), *outline.shares
    )


def _side(eye: Eye, drum: Drum, outline: _Outline) -> Layer:
    tops, bottoms = (eye.rows(height_m, 1 / outline.near_m) for height_m in (drum.height_m, drum.bottom_m))
    return Layer(
        outline.first, tops, bottoms, lambda rect, target: _fill_side(eye, drum, outline, rect, target), *outline.shares
    )


def _fill_side(eye: Eye, drum: Drum, outline: _Outline, rect: Rect, target: Image) -> None:
    texture, focal_px = drum.side, eye.focal_px
    px_per_m = focal_px / float(outline.near_m.min())
    along, across = (texture.level(texture.per_m[axis] / px_per_m, axis) for axis in (0, 1))
    image = texture.version(along, across)
    turns = outline.facing - (drum.yaw_rad / (2 * math.pi) - 0.5)
    turns -= np.floor(turns)
    down = np.arange(rect.top, rect.bottom, dtype=np.float32) - np.float32(eye.centre_px[1])
    per_m = texture.per_m[1] / 2**across
    columns = np.empty((len(down), len(turns)), np.float32)
    columns[:] = turns * (image.shape[1] - 1 - 2 * PAD) + PAD
    rows = down[:, np.newaxis] * (outline.near_m * per_m / focal_px).astype(np.float32)
    rows += np.float32((drum.height_m - eye.z_m) * per_m + PAD)
    cv2.remap(image, columns, rows, cv2.INTER_LINEAR, dst=target, borderMode=cv2.BORDER_REPLICATE)
    if drum.gains is not None:
        gains = np.empty(target.shape[:2], np.float32)
        gains[:] = np.interp(outline.facing, _turn(len(drum.gains)), drum.gains)
        cv2.blendLinear(target, _black(target.shape), gains, 1 - gains, target)


@lru_cache(maxsize=64)
def _black(shape: tuple[int, ...]) -> Image:
    """Return a black image, which must not be changed."""
    return np.zeros(shape, np.uint8)


@lru_cache(maxsize=8)
def _turn(count: int) -> NDArray[np.float64]:
    """Return equal steps of a full turn, from -0.5 to 0.5."""
    return np.linspace(-0.5, 0.5, count)
