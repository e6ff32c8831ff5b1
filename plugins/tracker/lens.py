"""The lens of a camera: pixels to rays and back."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]

_STOP: Final = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 40, 1e-8)
_LEVEL: Final = 1e6  # the tangent of nearly a right angle


class Lens:
    """A calibrated lens with the distortion model of OpenCV and ROS (`plumb_bob`).

    Args:
        size_px: width and height of the calibrated pictures.
        focal_px: focal lengths along the columns and the rows.
        centre_px: column and row of the axis; the centre of the first pixel is 0, 0.
        distortion: k1, k2, p1, p2, k3.

    Attributes:
        size_px: width and height of the calibrated pictures.
        matrix: the camera matrix, (3, 3).
        distortion: k1, k2, p1, p2, k3.
    """

    def __init__(
        self,
        size_px: tuple[int, int],
        focal_px: tuple[float, float],
        centre_px: tuple[float, float],
        distortion: tuple[float, ...],
    ) -> None:
        self.size_px: Final = size_px
        self.matrix: Final = np.array(
            [[focal_px[0], 0.0, centre_px[0]], [0.0, focal_px[1], centre_px[1]], [0.0, 0.0, 1.0]]
        )
        self.distortion: Final = np.array(distortion)

    def rays(self, pixels: Floats) -> Floats:
        """Return where the rays of pixels pass the plane 1 m ahead, right and down, (n, 2) for (n, 2)."""
        points = np.ascontiguousarray(pixels, np.float64).reshape(-1, 1, 2)
        rays = cv2.undistortPoints(points, self.matrix, self.distortion, criteria=_STOP)
        return np.asarray(rays, np.float64).reshape(-1, 2)

    def pixels(self, points: Floats, turn: Floats, shift_m: Floats) -> Floats:
        """Return the pixels of points, (n, 2).

        Args:
            points: in the map frame, (n, 3), in metres.
            turn: rotation from the map frame to the camera's, as a rotation vector.
            shift_m: the map's origin in the camera's frame.
        """
        found, _ = cv2.projectPoints(points, turn, shift_m, self.matrix, self.distortion)
        return np.asarray(found, np.float64).reshape(-1, 2)

    def has_in_front(self, points: Floats, turn: Floats, shift_m: Floats) -> NDArray[np.bool_]:
        """Return which points, given as for `pixels`, the lens can show, be it outside the picture, (n,).

        `pixels` returns pixels also for points behind the camera, and for those so far from its axis that the
        polynomials of the distortion lead back into the picture.
        """
        matrix, _ = cv2.Rodrigues(turn)
        x_m, y_m, ahead_m = np.asarray(matrix, np.float64) @ points.T + shift_m.reshape(3, 1)
        return np.asarray((ahead_m > 0) & (np.hypot(x_m, y_m) < self._widest * ahead_m))

    @cached_property
    def _widest(self) -> float:
        """Tangent of the angle from the axis up to which points farther from it are farther from it in the picture."""
        k1, k2, _, _, k3 = self.distortion
        squares = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])  # of the tangents at which the radius in the picture rests
        return math.sqrt(squares[(squares.imag == 0) & (squares.real > 0)].real.min(initial=_LEVEL**2))
