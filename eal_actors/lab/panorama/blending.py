"""One image from placed frames: seams half way between them, blended in bands of detail."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.lab.panorama.cylinder import Floats, Image, Lens, unroll

_MOST_BANDS: Final = 5
_PAD_BANDS: Final = 2
"""The coarsest band looks so many of its pixels (as powers of two) beyond a column."""


@dataclass(frozen=True, slots=True)
class View:
    """A placed frame.

    Attributes:
        frame: as the camera took it.
        lens: of the camera.
        yaw_rad: where its axis looks.
        down_rad: how far its axis is below the horizon.
        gain: factor on its brightness.
    """

    frame: Image
    lens: Lens
    yaw_rad: float
    down_rad: float
    gain: float


@dataclass(frozen=True, slots=True)
class Canvas:
    """The part of the cylinder that is painted.

    Attributes:
        left_rad: yaw of its left edge.
        width: columns.
        top_px: row of its upper edge, from the horizon down.
        bottom_px: row of its lower edge.
        px_per_rad: columns in a radian.
        is_closed: whether its right edge is its left one.
    """

    left_rad: float
    width: int
    top_px: int
    bottom_px: int
    px_per_rad: float
    is_closed: bool

    def column(self, yaw_rad: float) -> float:
        """Return the column, from 0 to the width of a full ring, whose middle has a yaw."""
        return ((self.left_rad - yaw_rad) % (2 * math.pi)) * self.px_per_rad - 0.5


def owners_of(views: Mapping[int, View], columns_rad: Floats) -> NDArray[np.int64]:
    """Return the number of the frame whose axis is nearest to each yaw (w,); -1 where no frame reaches."""
    numbers = np.array(sorted(views))
    off_rad = np.array([np.abs(_wrapped(views[number].yaw_rad - columns_rad)) for number in numbers])
    nearest = off_rad.argmin(axis=0)
    half_rad = views[int(numbers[0])].lens.field_of_view_rad / 2
    reached = off_rad.min(axis=0) <= half_rad
    return np.where(reached, numbers[nearest], -1)


def common_rows(
    views: Mapping[int, View], columns_rad: Floats, owners: NDArray[np.int64], px_per_rad: float
) -> tuple[int, int]:
    """Return the first row, from the horizon down, and the row after the last one that each column's frame reaches."""
    top, bottom = -math.inf, math.inf
    for number, view in views.items():
        off_rad = np.abs(_wrapped(view.yaw_rad - columns_rad[owners == number]))
        if off_rad.size:
            half_px = view.lens.height / 2 * math.cos(float(off_rad.max())) * px_per_rad / view.lens.focal_px
            middle_px = view.down_rad * px_per_rad
            top, bottom = max(top, middle_px - half_px), min(bottom, middle_px + half_px)
    return math.ceil(top), math.floor(bottom)


def blend(views: Mapping[int, View], owners: NDArray[np.int64], canvas: Canvas) -> Image:
    """Paint frames onto a canvas.

    Args:
        views: the frames, by their numbers.
        owners: the number of the frame that each column is taken from, -1 for none, (width,).
        canvas: what to paint.

    Returns:
        The image, (bottom - top, width, 3); black where no frame reaches.
    """
    bands = _bands(views, canvas)
    pad = 2 ** (bands + _PAD_BANDS) if canvas.is_closed else 0
    pad = min(pad, canvas.width)
    height = canvas.bottom_px - canvas.top_px
    blender = cv2.detail.MultiBandBlender()
    blender.setNumBands(bands)
    blender.prepare((-pad, 0, canvas.width + 2 * pad, height))
    for number, view in views.items():
        for columns in _columns(view, canvas, pad):
            owned = owners[columns % canvas.width] == number
            if owned.any():
                mask = np.ascontiguousarray(
                    np.broadcast_to(np.where(owned, 255, 0).astype(np.uint8), (height, owned.size))
                )
                blender.feed(_painted(view, columns, canvas), mask, (int(columns[0]), 0))
    blended, _ = blender.blend(None, None)  # type: ignore[call-overload]  # it makes both
    return np.ascontiguousarray(blended[:height, pad : pad + canvas.width].clip(0, 255).astype(np.uint8))


def _columns(view: View, canvas: Canvas, pad: int) -> list[NDArray[np.int64]]:
    """Return the columns of the padded canvas that a frame reaches, once for each time it comes by."""
    middle, half = canvas.column(view.yaw_rad), view.lens.field_of_view_rad / 2 * canvas.px_per_rad
    ring = 2 * math.pi * canvas.px_per_rad
    found = []
    for lap in (-1, 0, 1):
        first = max(math.ceil(middle - half + lap * ring), -pad)
        last = min(math.floor(middle + half + lap * ring), canvas.width + pad - 1)
        if first <= last:
            found.append(np.arange(first, last + 1))
    return found


def _painted(view: View, columns: NDArray[np.int64], canvas: Canvas) -> NDArray[np.int16]:
    yaws_rad = canvas.left_rad - (columns + 0.5) / canvas.px_per_rad
    right_rad = _wrapped(view.yaw_rad - yaws_rad)
    down_px = np.arange(canvas.top_px, canvas.bottom_px) + 0.5 - view.down_rad * canvas.px_per_rad
    colours, _ = unroll(view.frame, view.lens, right_rad, down_px, canvas.px_per_rad)
    return np.asarray(np.rint(colours * np.float32(view.gain)), np.int16)


def _bands(views: Mapping[int, View], canvas: Canvas) -> int:
    """Return how many bands fit: the coarsest must not blend wider than the frames overlap."""
    ordered = np.sort([canvas.column(view.yaw_rad) for view in views.values()])
    turns = np.diff(ordered, append=ordered[0] + 2 * math.pi * canvas.px_per_rad)
    reach = min(view.lens.field_of_view_rad for view in views.values()) * canvas.px_per_rad
    overlaps = [reach - turn for turn in turns if turn < reach]
    narrowest = min([*overlaps, canvas.bottom_px - canvas.top_px])
    return int(np.clip(math.log2(max(narrowest, 2)) - 1, 1, _MOST_BANDS))


def _wrapped(angles_rad: Any) -> Any:
    return (angles_rad + math.pi) % (2 * math.pi) - math.pi
