"""Blending of placed frames into one image: seams where neighbours agree, multi-band blending."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.lab.panorama.cylinder import Attitude, Floats, Image, Mask, resampled, wrapped_rad
from eal_actors.lab.panorama.parallax import TurnedCamera

_MOST_BANDS: Final = 5
_PAD_BANDS: Final = 2  # reach of the coarsest band beyond a column, in its pixels, as a power of two
_SMOOTH_PX: Final = 2.0  # of differences between neighbours, so that noise bends no seam
_DETOUR: Final = 0.02  # grey levels of difference that a seam accepts for each pixel nearer to the middle
_OUTSIDE: Final = 1e4  # grey levels for a pixel that one of the two frames does not show

Owners = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class PlacedFrame:
    """A placed frame."""

    frame: Image
    camera: TurnedCamera
    attitude: Attitude
    gain: float

    def pixels(self, yaws_rad: Floats, down: Floats) -> tuple[Floats, Floats, Mask]:
        """Return the frame's pixels in directions from the axis, as `TurnedCamera.pixels` does.

        The directions are `yaws_rad`, (w,), and tangents of their depression, (h,).
        """
        right_rad = np.clip(wrapped_rad(self.attitude.yaw_rad - yaws_rad), -math.pi / 2, math.pi / 2)
        return self.camera.pixels(right_rad, down[:, np.newaxis], self.attitude)

    def project(self, yaws_rad: Floats, down: Floats) -> tuple[NDArray[np.int16], Mask]:
        """Return what the frame shows at yaws (w,) and tangents of depression (h,), and the mask of the frame."""
        x, y, reaches = self.pixels(yaws_rad, down)
        return np.asarray(np.rint(resampled(self.frame, x, y) * np.float32(self.gain)), np.int16), reaches


@dataclass(frozen=True, slots=True)
class PanoramaCanvas:
    """The part of the cylinder that becomes the image; rows count from the horizon down.

    `left_rad` is the yaw of its left edge, which its right edge joins if it `is_closed`.
    """

    left_rad: float
    width: int
    top_px: int
    bottom_px: int
    px_per_rad: float
    is_closed: bool

    @property
    def down(self) -> Floats:
        """Tangent of the depression of each row."""
        return (np.arange(self.top_px, self.bottom_px) + 0.5) / self.px_per_rad

    def yaws_rad(self, columns: NDArray[np.int64]) -> Floats:
        """Return the yaw of the centres of columns."""
        return self.left_rad - (columns + 0.5) / self.px_per_rad

    def column(self, yaw_rad: float) -> float:
        """Return the column whose centre has a yaw, from 0 to the width of a full ring."""
        return ((self.left_rad - yaw_rad) % (2 * math.pi)) * self.px_per_rad - 0.5


def owners_of(views: Mapping[int, PlacedFrame], columns_rad: Floats) -> Owners:
    """Return the number of the frame whose axis is nearest to each yaw (w,); -1 outside of all frames."""
    numbers = np.array(sorted(views))
    off_rad = np.array([np.abs(wrapped_rad(views[number].attitude.yaw_rad - columns_rad)) for number in numbers])
    nearest = off_rad.argmin(axis=0)
    reached = off_rad.min(axis=0) <= views[int(numbers[0])].camera.lens.half_view_rad
    return np.where(reached, numbers[nearest], -1)


def common_rows(
    views: Mapping[int, PlacedFrame], columns_rad: Floats, owners: Owners, px_per_rad: float
) -> tuple[int, int]:
    """Return the first row, from the horizon down, and the row after the last one, that all columns' frames reach."""
    top, bottom = -math.inf, math.inf
    for number, view in views.items():
        own_rad = columns_rad[owners == number]
        if own_rad.size:
            lens = view.camera.lens
            most_px = int(lens.height * px_per_rad / lens.focal_px)
            rows = np.arange(-most_px, most_px)
            x, _, reaches = view.pixels(own_rad, (rows + 0.5) / px_per_rad)
            middle = np.abs(x - (lens.width - 1) / 2) <= lens.width / 2  # the sides of the frame do not count
            seen = rows[(reaches | ~middle).all(axis=1) & reaches.any(axis=1)]
            top, bottom = (max(top, seen[0]), min(bottom, seen[-1] + 1)) if seen.size else (math.inf, -math.inf)
    return (int(top), int(bottom)) if top < bottom else (0, 0)


def find_seams(
    views: Mapping[int, PlacedFrame], order: Sequence[int], owners: Owners, canvas: PanoramaCanvas
) -> Owners:
    """Return the number of the frame that provides each pixel, (height, width).

    Between two neighbours the seam takes the way on which they differ least, so that something that moved or stands
    near is shown by one of them and not by half of each. `order` are the numbers of the views from left to right,
    `owners` that of the one nearest to each column, -1 for none, (width,).
    """
    found = np.tile(owners, (canvas.bottom_px - canvas.top_px, 1))
    pairs = list(zip(order, [*order[1:], order[0]], strict=True))
    for left, right in pairs if canvas.is_closed else pairs[:-1]:
        first, end = canvas.column(views[left].attitude.yaw_rad), canvas.column(views[right].attitude.yaw_rad)
        if end < first:
            end += 2 * math.pi * canvas.px_per_rad
        columns = np.arange(math.ceil(first), math.floor(end) + 1)
        if not 0 < len(columns) < 2 * views[left].camera.lens.half_view_rad * canvas.px_per_rad:
            continue  # one direction, or no overlap
        yaws_rad = canvas.yaws_rad(columns)
        one, one_reaches = views[left].project(yaws_rad, canvas.down)
        other, other_reaches = views[right].project(yaws_rad, canvas.down)
        both = one_reaches & other_reaches
        own = columns % canvas.width
        if not both.any() or (owners[own] < 0).any():
            continue
        differences = cv2.GaussianBlur(np.abs(one - other).astype(np.float32).mean(axis=2), (0, 0), _SMOOTH_PX)
        detours = _DETOUR * np.abs(columns - (first + end) / 2)
        seam = _least_path(np.where(both, differences + detours, _OUTSIDE))
        found[:, own] = np.where(np.arange(len(columns)) <= seam[:, np.newaxis], left, right)
    return found


def _least_path(costs: Floats) -> NDArray[np.int64]:
    """Return the column of the cheapest path from the top to the bottom, (h,); costs (h, w)."""
    # Once: for each row it is slow.
    padded = np.pad(np.asarray(costs, np.float64), ((0, 0), (1, 1)), constant_values=np.inf)
    sums = padded[:, 1:-1]
    for above, row in zip(padded, sums[1:], strict=False):
        row += np.minimum(np.minimum(above[:-2], above[1:-1]), above[2:])
    path = np.empty(len(sums), np.int64)
    path[-1] = sums[-1].argmin()
    for row in range(len(sums) - 2, -1, -1):
        first = max(int(path[row + 1]) - 1, 0)
        path[row] = first + sums[row, first : path[row + 1] + 2].argmin()
    return path


def blend(views: Mapping[int, PlacedFrame], owners: Owners, canvas: PanoramaCanvas) -> Image:
    """Return the image blended from frames, (bottom - top, width, 3); black outside of all frames.

    `owners` has the number of the frame that provides each pixel, -1 for none, (height, width).
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
            owned = owners[:, columns % canvas.width] == number
            if owned.any():
                mask = np.ascontiguousarray(np.where(owned, 255, 0).astype(np.uint8))
                colours, _ = view.project(canvas.yaws_rad(columns), canvas.down)
                blender.feed(colours, mask, (int(columns[0]), 0))
    blended, _ = blender.blend(None, None)  # type: ignore[call-overload]  # the stub lacks the form that allocates both results
    return np.ascontiguousarray(blended[:height, pad : pad + canvas.width].clip(0, 255).astype(np.uint8))


def _reached_columns(view: PlacedFrame, canvas: PanoramaCanvas, pad: int) -> list[NDArray[np.int64]]:
    """Return the columns of the padded canvas that a frame reaches, for each lap round the ring."""
    middle, half = canvas.column(view.attitude.yaw_rad), view.camera.lens.half_view_rad * canvas.px_per_rad
    ring = 2 * math.pi * canvas.px_per_rad
    found = []
    for lap in (-1, 0, 1):
        first = max(math.ceil(middle - half + lap * ring), -pad)
        last = min(math.floor(middle + half + lap * ring), canvas.width + pad - 1)
        if first <= last:
            found.append(np.arange(first, last + 1))
    return found


def _bands(views: Mapping[int, PlacedFrame], canvas: PanoramaCanvas) -> int:
    """Return the number of bands; the coarsest band must not reach beyond the overlaps of the frames."""
    ordered = np.sort([canvas.column(view.attitude.yaw_rad) for view in views.values()])
    turns = np.diff(ordered, append=ordered[0] + 2 * math.pi * canvas.px_per_rad)
    reach = min(2 * view.camera.lens.half_view_rad for view in views.values()) * canvas.px_per_rad
    overlaps = [reach - turn for turn in turns if turn < reach]
    narrowest = min([*overlaps, canvas.bottom_px - canvas.top_px])
    return int(np.clip(math.log2(max(narrowest, 2)) - 1, 1, _MOST_BANDS))
