"""Blending of placed frames into one image: seams half way between their axes, multi-band blending."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.lab.panorama.cylinder import CameraLens, Floats, Image, project_frame, wrapped_rad

_MOST_BANDS: Final = 5
_PAD_BANDS: Final = 2  # reach of the coarsest band beyond a column, in its pixels, as a power of two


@dataclass(frozen=True, slots=True)
class PlacedFrame:
    """A placed frame.

    Attributes:
        yaw_rad: yaw of its axis.
        down_rad: depression of its axis below the horizon.
        gain: factor on its brightness.
    """

    frame: Image
    lens: CameraLens
    yaw_rad: float
    down_rad: float
    gain: float


@dataclass(frozen=True, slots=True)
class PanoramaCanvas:
    """The part of the cylinder that becomes the image.

    Attributes:
        left_rad: yaw of its left edge.
        top_px: row of its upper edge, from the horizon down.
        bottom_px: row of its lower edge.
        px_per_rad: columns per radian.
        is_closed: whether its right edge joins its left edge.
    """

    left_rad: float
    width: int
    top_px: int
    bottom_px: int
    px_per_rad: float
    is_closed: bool

    def column(self, yaw_rad: float) -> float:
        """Return the column whose centre has a yaw, from 0 to the width of a full ring."""
        return ((self.left_rad - yaw_rad) % (2 * math.pi)) * self.px_per_rad - 0.5


def owners_of(views: Mapping[int, PlacedFrame], columns_rad: Floats) -> NDArray[np.int64]:
    """Return the number of the frame whose axis is nearest to each yaw (w,); -1 outside of all frames."""
    numbers = np.array(sorted(views))
    off_rad = np.array([np.abs(wrapped_rad(views[number].yaw_rad - columns_rad)) for number in numbers])
    nearest = off_rad.argmin(axis=0)
    half_rad = views[int(numbers[0])].lens.field_of_view_rad / 2
    reached = off_rad.min(axis=0) <= half_rad
    return np.where(reached, numbers[nearest], -1)


def common_rows(
    views: Mapping[int, PlacedFrame], columns_rad: Floats, owners: NDArray[np.int64], px_per_rad: float
) -> tuple[int, int]:
    """Return the first row, from the horizon down, and the row after the last one, that all columns' frames reach."""
    top, bottom = -math.inf, math.inf
    for number, view in views.items():
        off_rad = np.abs(wrapped_rad(view.yaw_rad - columns_rad[owners == number]))
        if off_rad.size:
            half_px = view.lens.height / 2 * math.cos(float(off_rad.max())) * px_per_rad / view.lens.focal_px
            middle_px = view.down_rad * px_per_rad
            top, bottom = max(top, middle_px - half_px), min(bottom, middle_px + half_px)
    return math.ceil(top), math.floor(bottom)


def blend(views: Mapping[int, PlacedFrame], owners: NDArray[np.int64], canvas: PanoramaCanvas) -> Image:
    """Blend frames into an image.

    Args:
        views: the placed frames, by number.
        owners: the number of the frame that provides each column, -1 for none, (width,).
        canvas: the part of the cylinder to fill.

    Returns:
        The image, (bottom - top, width, 3); black outside of all frames.
    """
    bands = _bands(views, canvas)
    pad = 2 ** (bands + _PAD_BANDS) if canvas.is_closed else 0
    pad = min(pad, canvas.width)
    height = canvas.bottom_px - canvas.top_px
    blender = cv2.detail.MultiBandBlender()
    blender.setNumBands(bands)
    blender.prepare((-pad, 0, canvas.width + 2 * pad, height))
    for number, view in views.items():
        for columns in _reached_columns(view, canvas, pad):
            owned = owners[columns % canvas.width] == number
            if owned.any():
                mask = np.ascontiguousarray(
                    np.broadcast_to(np.where(owned, 255, 0).astype(np.uint8), (height, owned.size))
                )
                blender.feed(_render(view, columns, canvas), mask, (int(columns[0]), 0))
    blended, _ = blender.blend(None, None)  # type: ignore[call-overload]  # the stub lacks the form that allocates both results
    return np.ascontiguousarray(blended[:height, pad : pad + canvas.width].clip(0, 255).astype(np.uint8))


def _reached_columns(view: PlacedFrame, canvas: PanoramaCanvas, pad: int) -> list[NDArray[np.int64]]:
    """Return the columns of the padded canvas that a frame reaches, for each lap round the ring."""
    middle, half = canvas.column(view.yaw_rad), view.lens.field_of_view_rad / 2 * canvas.px_per_rad
    ring = 2 * math.pi * canvas.px_per_rad
    found = []
    for lap in (-1, 0, 1):
        first = max(math.ceil(middle - half + lap * ring), -pad)
        last = min(math.floor(middle + half + lap * ring), canvas.width + pad - 1)
        if first <= last:
            found.append(np.arange(first, last + 1))
    return found


def _render(view: PlacedFrame, columns: NDArray[np.int64], canvas: PanoramaCanvas) -> NDArray[np.int16]:
    yaws_rad = canvas.left_rad - (columns + 0.5) / canvas.px_per_rad
    right_rad = wrapped_rad(view.yaw_rad - yaws_rad)
    down_px = np.arange(canvas.top_px, canvas.bottom_px) + 0.5 - view.down_rad * canvas.px_per_rad
    colours, _ = project_frame(view.frame, view.lens, right_rad, down_px, canvas.px_per_rad)
    return np.asarray(np.rint(colours * np.float32(view.gain)), np.int16)


def _bands(views: Mapping[int, PlacedFrame], canvas: PanoramaCanvas) -> int:
    """Return the number of bands; the coarsest band must not reach beyond the overlaps of the frames."""
    ordered = np.sort([canvas.column(view.yaw_rad) for view in views.values()])
    turns = np.diff(ordered, append=ordered[0] + 2 * math.pi * canvas.px_per_rad)
    reach = min(view.lens.field_of_view_rad for view in views.values()) * canvas.px_per_rad
    overlaps = [reach - turn for turn in turns if turn < reach]
    narrowest = min([*overlaps, canvas.bottom_px - canvas.top_px])
    return int(np.clip(math.log2(max(narrowest, 2)) - 1, 1, _MOST_BANDS))
