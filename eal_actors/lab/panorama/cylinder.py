"""Frames of a level pinhole camera, projected onto a cylinder round the camera's axis of rotation.

The columns of the cylinder are equidistant in yaw. On it, the image of a turned camera is shifted, not distorted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

Image: TypeAlias = NDArray[np.uint8]
"""Rows from the top, shape (height, width, 3): red, green and blue."""
Floats: TypeAlias = NDArray[np.floating[Any]]
Mask: TypeAlias = NDArray[np.bool_]
PlacedBy: TypeAlias = Literal["features", "gradients", "odometry only"]
"""The source of a frame's position."""

WINDOW_RAD: Final = math.radians(12)
"""Largest error of odometry about the turn between two frames."""
TILT_RAD: Final = math.radians(3)
"""Largest difference in elevation between two frames."""


def wrapped_rad(angle_rad: Any) -> Any:
    """Return an angle, or an array of angles, in [-pi, pi)."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi


@dataclass(frozen=True, slots=True)
class Shift:
    """Offset of a second frame's axis from that of a first frame, measured from their pictures.

    Attributes:
        right_px: offset to the right, in pixels of the cylinder.
        down_px: offset down.
        how: the method of measurement.
        sigma_px: estimated standard error.
    """

    right_px: float
    down_px: float
    how: PlacedBy
    sigma_px: float


@dataclass(frozen=True, slots=True)
class CameraLens:
    """A pinhole camera with square pixels and its axis through the centre of the frame.

    Attributes:
        width: width of the frame, in pixels.
        height: height of the frame, in pixels.
        field_of_view_rad: angle between the left and the right edge of the frame, under pi.
    """

    width: int
    height: int
    field_of_view_rad: float

    @classmethod
    def of(cls, frame: Image, field_of_view_rad: float) -> CameraLens:
        """Return the lens of a frame."""
        return cls(frame.shape[1], frame.shape[0], field_of_view_rad)

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return self.width / 2 / math.tan(self.field_of_view_rad / 2)


def scaled_down(frame: Image, width: int) -> Image:
    """Return a frame scaled down to a width of at most `width` pixels."""
    if frame.shape[1] <= width:
        return frame
    height = max(1, round(frame.shape[0] * width / frame.shape[1]))
    return np.asarray(cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def project_frame(
    frame: Image, lens: CameraLens, right_rad: Floats, down_px: Floats, px_per_rad: float
) -> tuple[Image, Mask]:
    """Project a frame onto the cylinder.

    Args:
        frame: the camera's frame.
        lens: its lens.
        right_rad: angle of each column to the right of the camera's axis, (w,), less than a quarter turn.
        down_px: distance of each row below the horizon, in pixels of the cylinder, (h,).
        px_per_rad: pixels of the cylinder per radian, round it and (at the horizon) along it.

    Returns:
        The image (h, w, 3), which repeats the frame's edge outside of the frame; and the mask of the frame, (h, w).
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
    """A projected frame for comparisons, with its axis in the centre.

    Attributes:
        grey: brightness, (h, w) of unsigned bytes.
        reaches: mask of the frame, (h, w).
        colours: the projected frame.
        px_per_rad: pixels of the cylinder per radian.
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
    """Return the whole frame, projected."""
    lens = CameraLens.of(frame, field_of_view_rad)
    width = int(field_of_view_rad * px_per_rad)
    height = round(lens.height * px_per_rad / lens.focal_px)
    right_rad = (np.arange(width) - (width - 1) / 2) / px_per_rad
    down_px = np.arange(height) - (height - 1) / 2
    colours, reaches = project_frame(frame, lens, right_rad, down_px, px_per_rad)
    grey: NDArray[Any] = cv2.cvtColor(colours, cv2.COLOR_RGB2GRAY)
    return Patch(np.asarray(grey, np.uint8), reaches, colours, px_per_rad)
