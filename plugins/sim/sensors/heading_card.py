"""A picture that shows a robot's heading, in place of a camera's view."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

CAMERA_WIDTH_PX: Final = 320
CAMERA_HEIGHT_PX: Final = 240
CAMERA_FIELD_OF_VIEW_DEG: Final = 60.0

_COARSE_DEG, _FINE_DEG = 45, 5
_BANNER: Final = (
    ".................",
    ".###.###.###.###.",
    "..#..#...#....#..",
    "..#..##..###..#..",
    "..#..#.....#..#..",
    "..#..###.###..#..",
    ".................",
)
_BANNER_DOT_PX, _BANNER_LEFT_PX, _BANNER_TOP_PX = 12, 58, 24


def draw_test_card(yaw_rad: float) -> NDArray[np.uint8]:
    """Return an RGB image, shape (CAMERA_HEIGHT_PX, CAMERA_WIDTH_PX, 3), of a ring painted with the bearings.

    The colour of a column is the hue of its bearing. Dark ticks stand every 5 degrees, tall ones every 45 degrees. An
    object to the left is left in the image, as with any camera. A banner says TEST, so that nobody takes it for a view.
    """
    across = (np.arange(CAMERA_WIDTH_PX) + 0.5) / CAMERA_WIDTH_PX - 0.5
    bearing_deg = (math.degrees(yaw_rad) - across * CAMERA_FIELD_OF_VIEW_DEG) % 360.0
    phases = np.radians(bearing_deg[:, np.newaxis] - np.array([0.0, 120.0, 240.0]))
    row = np.rint(127.5 + 127.5 * np.cos(phases)).astype(np.uint8)
    image = np.repeat(row[np.newaxis], CAMERA_HEIGHT_PX, axis=0)
    for step_deg, top in ((_FINE_DEG, CAMERA_HEIGHT_PX * 3 // 4), (_COARSE_DEG, CAMERA_HEIGHT_PX // 2)):
        off_deg = np.abs((bearing_deg + step_deg / 2) % step_deg - step_deg / 2)
        image[top:, off_deg < 0.5] = 0
    dots = np.array([[255 * (dot == "#") for dot in line] for line in _BANNER], dtype=np.uint8)
    banner = dots.repeat(_BANNER_DOT_PX, axis=0).repeat(_BANNER_DOT_PX, axis=1)
    height_px, width_px = banner.shape
    right_px, bottom_px = _BANNER_LEFT_PX + width_px, _BANNER_TOP_PX + height_px
    image[_BANNER_TOP_PX:bottom_px, _BANNER_LEFT_PX:right_px] = banner[:, :, np.newaxis]
    return image
