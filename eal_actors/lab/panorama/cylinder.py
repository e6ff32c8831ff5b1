"""Frames of a level pinhole camera, unrolled onto a cylinder round the axis that the camera turns on.

Columns of the cylinder are equally far apart in yaw, and what a turned camera sees is shifted along it, not distorted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

Image: TypeAlias = NDArray[np.uint8]
"""Rows from the top, shape (height, width, 3): red, green and blue."""
Floats: TypeAlias = NDArray[np.floating[Any]]
Mask: TypeAlias = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Lens:
    """A pinhole with square pixels, its axis through the middle of the frame.

    Attributes:
        width: of the frame, in pixels.
        height: of the frame, in pixels.
        field_of_view_rad: angle between the left and the right edge of the frame, under pi.
    """

    width: int
    height: int
    field_of_view_rad: float

    @classmethod
    def of(cls, frame: Image, field_of_view_rad: float) -> Lens:
        """Return the lens that took a frame."""
        return cls(frame.shape[1], frame.shape[0], field_of_view_rad)

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return self.width / 2 / math.tan(self.field_of_view_rad / 2)


def shrunk(frame: Image, width: int) -> Image:
    """Return a frame no wider than so many pixels."""
    if frame.shape[1] <= width:
        return frame
    height = max(1, round(frame.shape[0] * width / frame.shape[1]))
    return np.asarray(cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def unroll(frame: Image, lens: Lens, right_rad: Floats, down_px: Floats, px_per_rad: float) -> tuple[Image, Mask]:
    """Return what a frame shows on the cylinder.

    Args:
        frame: as the camera took it.
        lens: of the camera.
        right_rad: how far to the right of the camera's axis each column is, (w,), within a quarter turn.
        down_px: how far below the horizon each row is, in pixels of the cylinder, (h,).
        px_per_rad: pixels of the cylinder in a radian, round it and (where it meets the horizon) along it.

    Returns:
        The image (h, w, 3), which repeats the frame's edge where the frame does not reach; and where it does, (h, w).
    """
    x = (lens.width - 1) / 2 + lens.focal_px * np.tan(right_rad)
    y = (lens.height - 1) / 2 + np.outer(down_px, lens.focal_px / px_per_rad / np.cos(right_rad))
    map_x = np.ascontiguousarray(np.broadcast_to(x, y.shape), np.float32)
    image = cv2.remap(frame, map_x, y.astype(np.float32), cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    reaches = (np.abs(x - (lens.width - 1) / 2) <= lens.width / 2) & (
        np.abs(y - (lens.height - 1) / 2) <= lens.height / 2
    )
    return np.asarray(image, np.uint8), reaches


@dataclass(frozen=True, slots=True)
class Patch:
    """A frame unrolled for comparing, its axis in the middle.

    Attributes:
        grey: its brightness, (h, w) of unsigned bytes.
        reaches: where the frame reaches, (h, w).
        colours: the unrolled frame.
        px_per_rad: pixels of the cylinder in a radian.
    """

    grey: NDArray[np.uint8]
    reaches: Mask
    colours: Image
    px_per_rad: float

    @property
    def centre_px(self) -> tuple[float, float]:
        """Column and row of the axis."""
        height, width = self.grey.shape
        return (width - 1) / 2, (height - 1) / 2


def patch_of(frame: Image, field_of_view_rad: float, px_per_rad: float) -> Patch:
    """Return a frame unrolled as far as it reaches."""
    lens = Lens.of(frame, field_of_view_rad)
    width = int(field_of_view_rad * px_per_rad)
    height = round(lens.height * px_per_rad / lens.focal_px)
    right_rad = (np.arange(width) - (width - 1) / 2) / px_per_rad
    down_px = np.arange(height) - (height - 1) / 2
    colours, reaches = unroll(frame, lens, right_rad, down_px, px_per_rad)
    grey: NDArray[Any] = cv2.cvtColor(colours, cv2.COLOR_RGB2GRAY)
    return Patch(np.asarray(grey, np.uint8), reaches, colours, px_per_rad)
