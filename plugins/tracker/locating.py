"""The pose of a level square at a known height, from its four corners in a picture.

The height is known, so the corners' rays end on a known plane. A square is fitted to the four ends. This is several
times as accurate as a free pose of the square (`solvePnP`), whose tilt and distance trade against its place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from .lens import Floats, Lens
from .mounting import Mounting

CORNER_PX: Final = 0.1
"""Standard deviation of a corner along each axis, in pixels: a noise of 4 grey levels gives a third of it."""
PLACE_SD_M: Final = 0.0007
"""Standard deviation of the errors that all pictures share: of the lens model, the floor markers and the height."""
YAW_SD_RAD: Final = math.radians(0.1)
"""Standard deviation of the yaw's shared errors."""
_MOST_STRETCH: Final = 0.1
"""Relative error of the size over which a marker is not level, or has another size or height."""
_MOST_BEND: Final = 0.04
"""Root mean square distance of the corners from a square over which it is not level, as a share of its side."""


@dataclass(frozen=True)
class SquareFit:
    """A square on a plane.

    Attributes:
        x_m: its centre in the map frame.
        y_m: its centre.
        yaw_rad: direction from its left side to its right side.
        stretch: its size over the expected size.
        bend: root mean square distance of the corners from the square, as a share of its side.
        covariance: of x_m, y_m and yaw_rad, (3, 3).
    """

    x_m: float
    y_m: float
    yaw_rad: float
    stretch: float
    bend: float
    covariance: Floats

    @property
    def misfit(self) -> str | None:
        """Why it is no level square of the expected size and height; None if it is one."""
        if not self.bend <= _MOST_BEND:
            return "it is not level"
        if not abs(self.stretch - 1) <= _MOST_STRETCH:
            return f"its size is {self.stretch:.0%} of the expected one: check its size and height"
        return None


def square_corners(size_m: float) -> Floats:
    """Return the corners of a marker in its own frame, x to its right, y up: top left, then clockwise, (4, 2)."""
    return np.array([(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]) * (size_m / 2)


def fit_squares(corners: Floats, lens: Lens, mounting: Mounting, heights_m: Floats, sizes_m: Floats) -> list[SquareFit]:
    """Fit squares to their corners in a picture.

    Args:
        corners: in pixels, in the order of `square_corners`, (n, 4, 2).
        lens: the camera's lens.
        mounting: the camera's pose.
        heights_m: of the squares over the floor, (n,).
        sizes_m: expected lengths of their sides, (n,).
    """
    ends = mounting.on_planes(lens.rays(corners.reshape(-1, 2)), np.repeat(heights_m, 4)).reshape(-1, 4, 2)
    found = ends[..., 0] + 1j * ends[..., 1]
    centres = found.mean(axis=1)
    models = sizes_m[:, np.newaxis] * (square_corners(1.0) @ np.array([1.0, 1j]))
    around = found - centres[:, np.newaxis]
    turns = (models.conj() * around).sum(axis=1) / (np.abs(models) ** 2).sum(axis=1)
    bends = np.sqrt(np.mean(np.abs(around - turns[:, np.newaxis] * models) ** 2, axis=1)) / sizes_m
    sides_px = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(axis=1)
    corners_m2 = (CORNER_PX * sizes_m / np.maximum(sides_px, 1.0)) ** 2
    places_m2 = corners_m2 / 4 + PLACE_SD_M**2
    yaws_rad2 = corners_m2 / (2 * sizes_m**2) + YAW_SD_RAD**2
    return [
        SquareFit(
            x_m=float(centre.real),
            y_m=float(centre.imag),
            yaw_rad=float(np.angle(turn)),
            stretch=float(abs(turn)),
            bend=float(bend),
            covariance=np.diag([place_m2, place_m2, yaw_rad2]),
        )
        for centre, turn, bend, place_m2, yaw_rad2 in zip(centres, turns, bends, places_m2, yaws_rad2, strict=True)
    ]
