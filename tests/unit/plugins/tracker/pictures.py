"""Pictures of markers by OpenCV's own drawing and projection: no code of the project is in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

SIZE = 960, 720
MATRIX = np.array([[760.0, 0, 481.0], [0, 760.0, 357.0], [0, 0, 1]])
DISTORTION = np.array([-0.18, 0.04, 0.001, -0.0005, 0.0])
FINER = 2
CELL_PX = 24
BITS = {cv2.aruco.DICT_4X4_50: 6, cv2.aruco.DICT_APRILTAG_36h11: 8}


@dataclass(frozen=True)
class Mark:
    """A marker in a scene; `tilt_deg` lifts its right edge, `is_mirrored` shows it as a mirror does."""

    number: int
    x_m: float
    y_m: float
    z_m: float = 0.0
    yaw_deg: float = 0.0
    size_m: float = 0.14
    tilt_deg: float = 0.0
    is_mirrored: bool = False

    def plate(self, scale: float) -> NDArray[np.float64]:
        """Return the corners of a square in the map frame, top left and then clockwise, (4, 3)."""
        half_m = self.size_m * scale / 2
        square = np.array([(-half_m, half_m, 0), (half_m, half_m, 0), (half_m, -half_m, 0), (-half_m, -half_m, 0)])
        tilt, yaw = math.radians(self.tilt_deg), math.radians(self.yaw_deg)
        lift = np.array([[math.cos(tilt), 0, 0], [0, 1, 0], [math.sin(tilt), 0, 1]])
        turn = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
        return np.asarray(square @ lift.T @ turn.T + (self.x_m, self.y_m, self.z_m))


@dataclass(frozen=True)
class View:
    """A camera above the floor, its picture's top towards +y."""

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 2.6
    tilt_deg: float = 5.0

    @property
    def turn(self) -> NDArray[np.float64]:
        tilt = math.radians(self.tilt_deg)
        ahead = np.array([0.0, math.sin(tilt), -math.cos(tilt)])
        right = np.array([1.0, 0.0, 0.0])
        return np.stack([right, np.cross(ahead, right), ahead])

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        vector, _ = cv2.Rodrigues(self.turn)
        shift = -self.turn @ np.array([self.x_m, self.y_m, self.z_m])
        return np.asarray(cv2.projectPoints(points, vector, shift, MATRIX, DISTORTION)[0], np.float64).reshape(-1, 2)


FLOOR = tuple(
    Mark(number, x_m, y_m, size_m=0.2)
    for number, (x_m, y_m) in enumerate([(-1.2, -0.75), (1.2, -0.75), (1.2, 0.95), (-1.2, 0.95)], start=40)
)


@cache
def draw(
    marks: tuple[Mark, ...], view: View | None = None, dictionary: int = cv2.aruco.DICT_4X4_50, seed: int = 1
) -> NDArray[np.uint8]:
    """Return the picture, (height, width, 3), with blur and noise. What is later in the list hides what is earlier."""
    view = view or View()
    kind, cells = cv2.aruco.getPredefinedDictionary(dictionary), BITS[dictionary]
    width, height = SIZE
    image = np.full((height * FINER, width * FINER), 120, np.uint8)
    for mark in marks:
        plate = cv2.aruco.generateImageMarker(kind, mark.number, cells * CELL_PX)
        plate = cv2.copyMakeBorder(plate, *(CELL_PX,) * 4, cv2.BORDER_CONSTANT, value=255)
        if mark.is_mirrored:
            plate = cv2.flip(plate, 1)
        side = plate.shape[0]
        source = np.array([(0, 0), (side, 0), (side, side), (0, side)], np.float32) - 0.5
        target = (view.project(mark.plate((cells + 2) / cells)) + 0.5) * FINER - 0.5
        matrix = cv2.getPerspectiveTransform(source, target.astype(np.float32))
        size = width * FINER, height * FINER
        cv2.warpPerspective(plate, matrix, size, image, cv2.INTER_AREA, cv2.BORDER_TRANSPARENT)
    small = cv2.GaussianBlur(cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA), (0, 0), 0.7).astype(np.float64)
    noisy = 0.85 * small + 20 + np.random.default_rng(seed).normal(0, 3, small.shape)
    return np.repeat(np.clip(np.rint(noisy), 0, 255).astype(np.uint8)[..., np.newaxis], 3, axis=2)


def cover(picture: NDArray[np.uint8], mark: Mark, view: View | None = None) -> NDArray[np.uint8]:
    """Return the picture with a hand over a marker."""
    corners = np.rint((view or View()).project(mark.plate(1.6))).astype(np.int32)
    covered = picture.copy()
    cv2.fillConvexPoly(covered, corners[:, np.newaxis], (90, 120, 180))
    return covered


__all__: Sequence[str] = ["DISTORTION", "FLOOR", "MATRIX", "SIZE", "Mark", "View", "cover", "draw"]
