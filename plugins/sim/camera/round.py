"""Drums: each column of the image meets a drum's side at one distance, so it is drawn column by column.

The outlines of all drums are computed together, one after the other in the same arrays: a drum has few columns, for
which a step of numpy costs as much as for the columns of all.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from .eye import NEAR_M, Eye, PinholeLens
from .flat import UNDERLAP_PX, fill_plane
from .layers import Layer, Rect, padded
from .solids import Drum, Tower
from .texture import PAD, Image, Mipmap

_WIDEST_RAD = math.radians(89.0)


class _DrumSpan(NamedTuple):
    """The columns of a drum in the image, and what does not change from one to the next."""

    first: int
    columns: int
    shares: tuple[float, float]
    lowest_slope: float
    highest_slope: float
    right_m: float
    ahead_m: float
    tangent_m2: float
    """Square of the distance along a ray that touches the drum."""


class _Outline(NamedTuple):
    """The outline of a drum in the image.

    Each array has a number for each column, and further ones up to a multiple of what OpenCV warps at once.

    Attributes:
        span: its columns.
        level: halvings of the texture of its side, along and across.
        tops: row of the upper edge of its side.
        bottoms: row of the lower edge of its side.
        backs: row of the far edge of its top.
        facing: where the side faces, counter-clockwise from the x axis, in turns, -0.5..0.5.
        along: column of the texture of its side.
        across: rows of the texture for each row of the image.
    """

    span: _DrumSpan
    level: tuple[int, int]
    tops: NDArray[np.float64]
    bottoms: NDArray[np.float64]
    backs: NDArray[np.float64]
    facing: NDArray[np.float64]
    along: NDArray[np.float32]
    across: NDArray[np.float32]


def tower_layers(eye: Eye, towers: Sequence[Tower]) -> list[list[Layer]]:
    """Return the layers of each tower in painting order."""
    outlines = iter(_outlines(eye, [drum for tower in towers for drum in tower.drums]))
    return [list(_stacked(eye, [(drum, next(outlines)) for drum in tower.drums])) for tower in towers]


def _stacked(eye: Eye, drums: Sequence[tuple[Drum, _Outline | None]]) -> Iterator[Layer]:
    (drum, outline), *above = drums
    if outline and eye.z_m > drum.height_m:
        yield _top(eye, drum, outline)
    if above:  # it hides the side of the drum below or is hidden by it
        yield from _stacked(eye, above)
    if outline:
        yield _side(eye, drum, outline)


def _span(eye: Eye, drum: Drum) -> _DrumSpan | None:
    right_m, ahead_m = eye.seen(drum.middle)
    distance_m = math.hypot(right_m, ahead_m)
    if distance_m <= drum.radius_m:
        return None
    bearing, half = math.atan2(right_m, ahead_m), math.asin(drum.radius_m / distance_m)
    if bearing - half >= _WIDEST_RAD or bearing + half <= -_WIDEST_RAD:
        return None
    lowest, highest = (math.tan(max(-_WIDEST_RAD, min(_WIDEST_RAD, edge))) for edge in (bearing - half, bearing + half))
    left, right = eye.column(lowest, 1.0), eye.column(highest, 1.0)
    end = eye.lens.width - 0.5
    if right <= -0.5 or left >= end:
        return None
    first, last = math.floor(max(left, 0.0) + 0.5), math.floor(min(right, end - 0.5) + 0.5)
    shares = 1.0 if left < -0.5 else first + 0.5 - left, 1.0 if right > end else min(1.0, right - max(last - 0.5, left))
    tangent_m2 = distance_m**2 - drum.radius_m**2
    return _DrumSpan(first, last - first + 1, shares, lowest, highest, right_m, ahead_m, tangent_m2)


def _outlines(eye: Eye, drums: Sequence[Drum]) -> list[_Outline | None]:
    """Return the outlines of drums; None for one that is not in the image."""
    spans = [_span(eye, drum) for drum in drums]
    seen = [(drum, span) for drum, span in zip(drums, spans, strict=True) if span is not None]
    found = iter(_in_columns(eye, seen)) if seen else iter(())
    return [None if span is None else next(found) for span in spans]


def _in_columns(eye: Eye, seen: Sequence[tuple[Drum, _DrumSpan]]) -> Iterator[_Outline]:
    """Yield the outlines of drums in the image."""
    counts = [padded(span.columns) for _, span in seen]
    starts = [0, *itertools.accumulate(counts)]
    size = starts.pop()
    numbers = [
        (span.first - start, *span[3:], *_placed(eye, drum)) for (drum, span), start in zip(seen, starts, strict=True)
    ]
    offset, lowest, highest, right_m, ahead_m, tangent_m2, away_x, away_y, yaw, top, bottom = np.repeat(
        np.array(numbers).T, counts, axis=1
    )
    (column_px, row_px), (ahead_x, ahead_y), (right_x, right_y) = eye.centre_px, eye.ahead, eye.right
    rays = (np.arange(size) + offset - column_px) / eye.focal_px
    rays = np.minimum(np.maximum(rays, lowest), highest)  # the centres of the outermost columns may be beyond the drum
    square = 1 + rays**2
    middle = (ahead_m + rays * right_m) / square
    half_chord = np.sqrt(np.maximum(middle**2 - tangent_m2 / square, 0.0))
    near_m = np.maximum(middle - half_chord, NEAR_M)
    far_m = np.maximum(middle + half_chord, near_m)
    hit_x, hit_y = near_m * (ahead_x + rays * right_x) + away_x, near_m * (ahead_y + rays * right_y) + away_y
    facing = np.arctan2(hit_y, hit_x) / (2 * math.pi)
    turns = facing - yaw
    turns -= np.floor(turns)
    nearest = np.minimum.reduceat(near_m, starts).tolist()
    levels = [_level(drum.side, nearest_m / eye.focal_px) for (drum, _), nearest_m in zip(seen, nearest, strict=True)]
    samples = [_samples(drum.side, level) for (drum, _), level in zip(seen, levels, strict=True)]
    around, across = np.repeat(np.array(samples).T, counts, axis=1)
    nearness = 1 / near_m
    arrays = (
        row_px - top * nearness,
        row_px - bottom * nearness,
        row_px - top * (1 / far_m),
        facing,
        (turns * around + PAD).astype(np.float32),
        (near_m * across / eye.focal_px).astype(np.float32),
    )
    for (_, span), level, start, count in zip(seen, levels, starts, counts, strict=True):
        yield _Outline(span, level, *(array[start : start + count] for array in arrays))


def _placed(eye: Eye, drum: Drum) -> tuple[float, ...]:
    """Return the way from a drum to the camera along x and y, its side's yaw in turns, and the heights of its edges."""
    x_m, y_m = drum.middle
    heights = eye.focal_px * (drum.height_m - eye.z_m), eye.focal_px * (drum.bottom_m - eye.z_m)
    return eye.x_m - x_m, eye.y_m - y_m, drum.yaw_rad / (2 * math.pi) - 0.5, *heights


def _level(side: Mipmap, m_per_px: float) -> tuple[int, int]:
    """Return the halvings of a side's texture, along and across, where it is nearest."""
    return side.level(side.per_m[0] * m_per_px, 0), side.level(side.per_m[1] * m_per_px, 1)


def _samples(side: Mipmap, level: tuple[int, int]) -> tuple[float, float]:
    """Return the intervals of a version of a side's texture around the drum, and those for each metre across."""
    return side.version(*level).shape[1] - 1 - 2 * PAD, side.per_m[1] / 2 ** level[1]


def _top(eye: Eye, drum: Drum, outline: _Outline) -> Layer:
    first, count, shares = outline.span[:3]
    return Layer(
        first, outline.backs[:count], outline.tops[:count] + UNDERLAP_PX, partial(fill_plane, eye, drum.top), *shares
    )


def _side(eye: Eye, drum: Drum, outline: _Outline) -> Layer:
    first, count, shares = outline.span[:3]
    return Layer(first, outline.tops[:count], outline.bottoms[:count], partial(_fill_side, eye, drum, outline), *shares)


def _fill_side(eye: Eye, drum: Drum, outline: _Outline, rect: Rect, target: Image) -> None:
    height, width = target.shape[:2]
    columns, rows = maps = np.empty((2, height, width), np.float32)
    columns[:] = outline.along[:width]
    np.multiply(_rows_below(eye.lens)[rect.top : rect.bottom], outline.across[:width], out=rows)
    rows += np.float32((drum.height_m - eye.z_m) * _samples(drum.side, outline.level)[1] + PAD)
    texture = drum.side.version(*outline.level)
    cv2.remap(texture, columns, rows, cv2.INTER_LINEAR, dst=target, borderMode=cv2.BORDER_REPLICATE)
    if drum.gains is not None:
        gains = np.interp(outline.facing[:width], _turn(len(drum.gains)), drum.gains).astype(np.float32)
        maps[0], maps[1] = gains, 1 - gains
        cv2.blendLinear(target, _black(height, width), columns, rows, target)


@lru_cache(maxsize=8)
def _rows_below(lens: PinholeLens) -> NDArray[np.float32]:
    """Return how far each row of the image is below its middle, (height, 1)."""
    return np.arange(lens.height, dtype=np.float32)[:, np.newaxis] - np.float32(lens.centre_px[1])


@lru_cache(maxsize=64)
def _black(rows: int, columns: int) -> Image:
    """Return a black image, which must not be changed."""
    return np.zeros((rows, columns, 4), np.uint8)


@lru_cache(maxsize=8)
def _turn(count: int) -> NDArray[np.float64]:
    """Return equal steps of a full turn, from -0.5 to 0.5."""
    return np.linspace(-0.5, 0.5, count)
