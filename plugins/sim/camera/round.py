"""Drums: each column of the image meets a drum's side at one distance, so it is drawn column by column.

The outlines of all drums are computed together, one after the other in the same arrays: a drum has few columns, for
which a step of numpy costs as much as for the columns of all.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from .eye import NEAR_M, Eye, Floats, PinholeLens
from .flat import UNDERLAP_PX, fill_plane
from .layers import Layer, Rect, padded
from .light import SIDES
from .solids import Drum, Tower
from .texture import PAD, Image, Mipmap

_WIDEST_RAD: Final = math.radians(89.0)
_GAIN: Final = 200
"""A gain of 1 as a byte; the greatest, of `RoomLight`, is 1.2."""
_TWICE_ROUND: Final = np.linspace(0.0, 2.0, 2 * SIDES + 1)
_EVEN: Final = np.ones(SIDES + 1)
_EXTREMES: Final = np.minimum, np.maximum


class _DrumSpan(NamedTuple):
    """The columns of a drum in the image, and its place there."""

    drum: Drum
    first: int
    columns: int
    shares: tuple[float, float]
    right_m: float
    ahead_m: float
    tangent_m2: float
    """Square of the distance along a ray that touches the drum."""


class _Side(NamedTuple):
    """The part of a texture that the columns of a drum's side show.

    Each array has a number for each column, and further ones up to a multiple of what OpenCV warps at once.

    Attributes:
        texture: a version of its texture.
        eye_row: row of the texture for the camera's height.
        along: column of the texture.
        across: rows of the texture for each row of the image.
        is_lit: whether it is as bright as `gains` say; else the light is in the texture.
        gains: brightness, (columns, 4); `_GAIN` is 1.
    """

    texture: Image
    eye_row: float
    along: NDArray[np.float32]
    across: NDArray[np.float32]
    is_lit: bool
    gains: Image


def tower_layers(eye: Eye, towers: Sequence[Tower]) -> list[list[Layer]]:
    """Return the layers of each tower in painting order."""
    spans = [[span for drum in tower.drums if (span := _span(eye, drum))] for tower in towers]
    found = _drum_layers(eye, [span for drums in spans for span in drums])
    return [_stacked([next(found) for _ in drums]) for drums in spans]


def _stacked(drums: Sequence[Sequence[Layer]]) -> list[Layer]:
    """Return the layers of stacked drums: one hides the side of the drum below it, or is hidden by it."""
    layers: list[Layer] = []
    for *top, side in reversed(drums):
        layers = [*top, *layers, side]
    return layers


def _span(eye: Eye, drum: Drum) -> _DrumSpan | None:
    right_m, ahead_m = eye.seen(drum.middle)
    distance_m = math.hypot(right_m, ahead_m)
    if distance_m <= drum.radius_m:
        return None
    bearing, half = math.atan2(right_m, ahead_m), math.asin(drum.radius_m / distance_m)
    if bearing - half >= _WIDEST_RAD or bearing + half <= -_WIDEST_RAD:
        return None
    left = eye.column(math.tan(max(bearing - half, -_WIDEST_RAD)), 1.0)
    right = eye.column(math.tan(min(bearing + half, _WIDEST_RAD)), 1.0)
    end = eye.lens.width - 0.5
    if right <= -0.5 or left >= end:
        return None
    first, last = math.floor(max(left, 0.0) + 0.5), math.floor(min(right, end - 0.5) + 0.5)
    shares = 1.0 if left < -0.5 else first + 0.5 - left, 1.0 if right > end else min(1.0, right - max(last - 0.5, left))
    return _DrumSpan(drum, first, last - first + 1, shares, right_m, ahead_m, distance_m**2 - drum.radius_m**2)


def _drum_layers(eye: Eye, spans: Sequence[_DrumSpan]) -> Iterator[list[Layer]]:
    """Yield the layers of drums in the image: the top if it is below the camera, and the side."""
    if not spans:
        return
    counts = [padded(span.columns) for span in spans]
    *starts, size = 0, *itertools.accumulate(counts)
    numbers = [_numbers(eye, span, start) for span, start in zip(spans, starts, strict=True)]
    offset, right_m, ahead_m, tangent_m2, top, bottom, turned = np.repeat(np.array(numbers).T, counts, axis=1)
    rays = (np.arange(size) + offset) / eye.focal_px
    square = rays * rays + 1
    middle = (ahead_m + rays * right_m) / square
    half_chord = np.sqrt(np.maximum(middle * middle - tangent_m2 / square, 0.0))
    near_m = np.maximum(middle - half_chord, NEAR_M)
    nearness, farness = 1 / near_m, 1 / np.maximum(middle + half_chord, near_m)
    edges = eye.centre_px[1] - np.array((top * nearness, bottom * nearness, top * farness))
    limits = zip(*(extreme.reduceat(edge, starts).tolist() for edge in edges for extreme in _EXTREMES), strict=True)
    turns = turned - np.arctan2(near_m * rays - right_m, near_m - ahead_m) / (2 * math.pi)
    turns -= np.floor(turns)
    gains = _gains(spans, counts, turns)
    nearest = np.minimum.reduceat(near_m, starts).tolist()
    levels = [_level(span.drum.side, near / eye.focal_px) for span, near in zip(spans, nearest, strict=True)]
    samples = [_samples(span.drum.side, level) for span, level in zip(spans, levels, strict=True)]
    around, across = np.repeat(np.array(samples).T, counts, axis=1)
    along, across = (turns * around + PAD).astype(np.float32), (near_m * across / eye.focal_px).astype(np.float32)
    tops, bottoms, backs = edges.astype(np.float32)
    for span, level, sample, start, limit in zip(spans, levels, samples, starts, limits, strict=True):
        drum, first, count, shares = span[:4]
        part, wide = slice(start, start + count), slice(start, start + padded(count))
        layers = []
        if eye.z_m > drum.height_m:
            extent = *limit[4:], limit[0] + UNDERLAP_PX, limit[1] + UNDERLAP_PX
            fill = partial(fill_plane, eye, drum.top)
            layers.append(Layer(first, backs[part], tops[part] + UNDERLAP_PX, extent, fill, *shares))
        eye_row = (drum.height_m - eye.z_m) * sample[1] + PAD
        side = _Side(drum.side.version(*level), eye_row, along[wide], across[wide], drum.gains is not None, gains[wide])
        fill = partial(_fill_side, eye.lens, side)
        layers.append(Layer(first, tops[part], bottoms[part], limit[:4], fill, *shares))
        yield layers


def _numbers(eye: Eye, span: _DrumSpan, start: int) -> tuple[float, ...]:
    """Return what each column of a drum needs.

    Returns:
        the column of the image, from its centre, of the array's first element, had it the drum's columns; the place of
        the drum; the heights of its edges; where its texture begins, seen from the camera, in turns.
    """
    drum, focal_px = span.drum, eye.focal_px
    heights_px = focal_px * (drum.height_m - eye.z_m), focal_px * (drum.bottom_m - eye.z_m)
    turned = (eye.yaw_rad - drum.yaw_rad) / (2 * math.pi) + 0.5
    return span.first - start - eye.centre_px[0], *span[4:], *heights_px, turned


def _gains(spans: Sequence[_DrumSpan], counts: Sequence[int], turns: Floats) -> Image:
    """Return how bright the columns of drums are, (columns, 4), each drum at a place of its own along one line.

    `turns` are where the columns face, from where the drum's texture begins.
    """
    gains = [_EVEN if span.drum.gains is None else span.drum.gains for span in spans]
    places = [3 * number + span.drum.yaw_rad / (2 * math.pi) % 1.0 for number, span in enumerate(spans)]
    line = np.add.outer(3.0 * np.arange(len(spans)), _TWICE_ROUND).ravel()
    known = np.concatenate([part for gain in gains for part in (gain, gain[1:])])
    found = np.interp(turns + np.repeat(places, counts), line, known) * _GAIN + 0.5
    return np.repeat(found.astype(np.uint8), 4).reshape(-1, 4)


def _level(side: Mipmap, m_per_px: float) -> tuple[int, int]:
    """Return the halvings of a side's texture, along and across, where it is nearest."""
    return side.level(side.per_m[0] * m_per_px, 0), side.level(side.per_m[1] * m_per_px, 1)


def _samples(side: Mipmap, level: tuple[int, int]) -> tuple[float, float]:
    """Return the intervals of a version of a side's texture around the drum, and those for each metre across."""
    return side.version(*level).shape[1] - 1 - 2 * PAD, side.per_m[1] / 2 ** level[1]


def _fill_side(lens: PinholeLens, side: _Side, rect: Rect, target: Image) -> None:
    width = target.shape[1]
    columns, rows = np.empty((2, *target.shape[:2]), np.float32)
    columns[:] = side.along[:width]
    np.multiply(lens.rows_below[rect.top : rect.bottom], side.across[:width], out=rows)
    rows += np.float32(side.eye_row)
    cv2.remap(side.texture, columns, rows, cv2.INTER_LINEAR, dst=target, borderMode=cv2.BORDER_REPLICATE)
    if side.is_lit:
        bright = np.empty(target.shape, np.uint8)
        bright[:] = side.gains[:width]
        cv2.multiply(target, bright, dst=target, scale=1 / _GAIN)
