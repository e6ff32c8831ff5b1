"""What a simulated robot senses of the world round it. Everything is geometry of the moment, without memory."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .robot import SimRobot

RAYS: Final = 16
MAX_RANGE_M: Final = 4.0
RAY_ANGLES_RAD: Final = np.arange(RAYS, dtype=np.float64) * (2 * math.pi / RAYS)

CAMERA_WIDTH_PX: Final = 320
CAMERA_HEIGHT_PX: Final = 240
CAMERA_FIELD_OF_VIEW_DEG: Final = 60.0

_BUMPER_REACH_M: Final = 0.003
_BUMPERS_OVERLAP_RAD: Final = math.radians(10)
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


def wrapped_rad(angle_rad: float) -> float:
    """Return the angle in (-pi, pi]."""
    wrapped = math.remainder(angle_rad, 2 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped


def pressed_bumpers(robot: SimRobot) -> tuple[bool, bool]:
    """Return whether the left and the right half of the front bumper are pressed; straight ahead presses both."""
    x_m, y_m, yaw_rad = robot.pose
    reach_m = robot.make.radius_m + _BUMPER_REACH_M
    left = right = False
    for hit in robot.space.point_query((x_m, y_m), reach_m, robot.filter):
        bearing = wrapped_rad(math.atan2(hit.point.y - y_m, hit.point.x - x_m) - yaw_rad)
        left |= -_BUMPERS_OVERLAP_RAD <= bearing <= math.pi / 2
        right |= -math.pi / 2 <= bearing <= _BUMPERS_OVERLAP_RAD
    return left, right


def ranges_m(robot: SimRobot, noise_m: float) -> NDArray[np.float64]:
    """Return the distance from the robot's centre to what each ray meets, MAX_RANGE_M where it meets nothing.

    Args:
        robot: whose rays they are.
        noise_m: standard deviation of normal noise; 0 draws nothing. A noisy range stays in 0..MAX_RANGE_M.
    """
    x_m, y_m, yaw_rad = robot.pose
    found = np.full(RAYS, MAX_RANGE_M)
    for ray, angle_rad in enumerate((RAY_ANGLES_RAD + yaw_rad).tolist()):
        end = x_m + MAX_RANGE_M * math.cos(angle_rad), y_m + MAX_RANGE_M * math.sin(angle_rad)
        if hit := robot.space.segment_query_first((x_m, y_m), end, 0.0, robot.filter):
            found[ray] = hit.alpha * MAX_RANGE_M
    if noise_m:
        noisy = found + noise_m * robot.sensor_generator.standard_normal(RAYS)
        found = np.where(found < MAX_RANGE_M, np.clip(noisy, 0.0, MAX_RANGE_M), found)
    return found


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
