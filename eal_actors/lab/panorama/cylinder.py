"""Frames of a level pinhole camera, projected onto a cylinder round the camera's axis of rotation.

The columns of the cylinder are equidistant in yaw. On it, the image of a turned camera is shifted, not distorted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, NamedTuple, TypeAlias

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
_UNDISTORT_STEPS: Final = 8
_LEAST_FORWARD: Final = 0.05


def wrapped_rad(angle_rad: Any) -> Any:
    """Return an angle, or an array of angles, in [-pi, pi)."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi


@dataclass(frozen=True, slots=True, eq=False)
class Shift:
    """Offset of a second frame's axis from that of a first frame, measured from their pictures.

    Attributes:
        right_px: offset to the right, in pixels of the cylinder.
        first_px: points of the first frame's patch, from its centre to the right and down, (n, 2).
        second_px: the same points in the second frame's patch, (n, 2).
        how: the method of measurement.
        sigma_px: estimated standard error of a point.
    """

    right_px: float
    first_px: Floats
    second_px: Floats
    how: PlacedBy
    sigma_px: float


class Attitude(NamedTuple):
    """Direction of a camera: the yaw of its axis, counter-clockwise; its depression; and its rotation, clockwise."""

    yaw_rad: float
    down_rad: float = 0.0
    roll_rad: float = 0.0


LEVEL: Final = Attitude(0.0)


@dataclass(frozen=True, slots=True)
class CameraLens:
    """A camera with square pixels and its axis through the centre of the frame. Width and height are in pixels.

    Attributes:
        field_of_view_rad: angle between the left and the right edge of the frame without distortion, under pi.
        k1: radial distortion as OpenCV defines it: at r focal lengths from the axis it multiplies r by 1 + k1 r^2.
    """

    width: int
    height: int
    field_of_view_rad: float
    k1: float = 0.0

    @classmethod
    def of(cls, frame: Image, field_of_view_rad: float) -> CameraLens:
        """Return a lens without distortion for a frame."""
        return cls(frame.shape[1], frame.shape[0], field_of_view_rad)

    def scaled(self, width: int, height: int) -> CameraLens:
        """Return the lens for frames of another size."""
        return replace(self, width=width, height=height)

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return self.width / 2 / math.tan(self.field_of_view_rad / 2)

    @property
    def half_view_rad(self) -> float:
        """Angle between the axis and the left or right edge of the frame."""
        return float(self.rays(np.array([[self.width / 2, 0.0]]))[0][0])

    def rays(self, pixels: Floats, down_rad: Any = 0.0, roll_rad: Any = 0.0) -> tuple[Floats, Floats]:
        """Return the angle of pixels to the right of the camera's yaw, and the tangent of their depression, (n,) each.

        Pixels are offsets from the centre of the frame to the right and down, (n, 2). The depression and the roll of
        the camera are one or (n,) each.
        """
        far_x, far_y = pixels[:, 0] / self.focal_px, pixels[:, 1] / self.focal_px
        x, y = far_x, far_y
        for _ in range(_UNDISTORT_STEPS if self.k1 else 0):
            scale = 1 + self.k1 * (x * x + y * y)
            x, y = far_x / scale, far_y / scale
        cos, sin = np.cos(roll_rad), np.sin(roll_rad)
        x, y = cos * x - sin * y, sin * x + cos * y
        cos, sin = np.cos(down_rad), np.sin(down_rad)
        forward, down = cos - sin * y, sin + cos * y
        return np.arctan2(x, forward), down / np.hypot(forward, x)

    def pixels(self, right_rad: Floats, down: Floats, attitude: Attitude = LEVEL) -> tuple[Floats, Floats, Mask]:
        """Return columns and rows that show directions, and whether they are in the frame: the inverse of `rays`.

        `right_rad` are angles to the right of the camera's yaw, less than a quarter turn; `down` are tangents of the
        depression, of a shape that goes with that of the angles. The yaw of the attitude does not count.
        """
        ahead, x, below = np.cos(right_rad), np.sin(right_rad), down
        cos, sin = math.cos(attitude.down_rad), math.sin(attitude.down_rad)
        forward, y = np.maximum(cos * ahead + sin * below, _LEAST_FORWARD), cos * below - sin * ahead
        x, y = x / forward, y / forward
        cos, sin = math.cos(attitude.roll_rad), math.sin(attitude.roll_rad)
        x, y = cos * x + sin * y, cos * y - sin * x
        square = x * x + y * y
        is_seen = (1 + 3 * self.k1 * square > 0) & (forward > _LEAST_FORWARD)  # beyond, the distortion turns back
        scale = self.focal_px * (1 + self.k1 * square)
        x, y = scale * x, scale * y
        is_seen = is_seen & (np.abs(x) <= self.width / 2) & (np.abs(y) <= self.height / 2)
        return x + (self.width - 1) / 2, y + (self.height - 1) / 2, is_seen


def scaled_down(frame: Image, width: int) -> Image:
    """Return a frame scaled down to a width of at most `width` pixels."""
    if frame.shape[1] <= width:
        return frame
    height = max(1, round(frame.shape[0] * width / frame.shape[1]))
    return np.asarray(cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def resampled(frame: Image, x: Floats, y: Floats) -> Image:
    """Return the frame at columns and rows (h, w) each; its edge is repeated outside."""
    maps = x.astype(np.float32), y.astype(np.float32)
    return np.asarray(cv2.remap(frame, *maps, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE), np.uint8)
