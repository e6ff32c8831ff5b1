"""The pose of a camera and the projection of its lens."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.floating[Any]]

NEAR_M: Final = 1e-3
"""The near clipping distance."""


@dataclass(frozen=True)
class PinholeLens:
    """A pinhole camera with square pixels and its axis through the centre of the image.

    Attributes:
        width: of the image, in pixels.
        height: of the image, in pixels.
        fov_deg: angle between the left and the right edge of the image, under 180.
    """

    width: int = 640
    height: int = 480
    fov_deg: float = 60.0

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return self.width / 2 / math.tan(math.radians(self.fov_deg) / 2)

    @property
    def centre_px(self) -> tuple[float, float]:
        """Column and row of the axis; the centre of the first pixel is 0, 0."""
        return (self.width - 1) / 2, (self.height - 1) / 2

    @cached_property
    def rows_below(self) -> NDArray[np.float32]:
        """How far each row of the image is below its centre, (height, 1)."""
        return np.arange(self.height, dtype=np.float32)[:, np.newaxis] - np.float32(self.centre_px[1])

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The camera matrix, (3, 3): x right, y down, z forward to pixels."""
        column, row = self.centre_px
        return np.array([[self.focal_px, 0.0, column], [0.0, self.focal_px, row], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Eye:
    """A level camera in the world's frame.

    Attributes:
        z_m: its height over the floor.
        yaw_rad: its viewing direction, counter-clockwise from the x axis.
    """

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    lens: PinholeLens = PinholeLens()

    @cached_property
    def ahead(self) -> tuple[float, float]:
        """Unit vector on the floor plan, along the axis."""
        return math.cos(self.yaw_rad), math.sin(self.yaw_rad)

    @cached_property
    def right(self) -> tuple[float, float]:
        """Unit vector on the floor plan, towards the right of the image."""
        return math.sin(self.yaw_rad), -math.cos(self.yaw_rad)

    @cached_property
    def focal_px(self) -> float:
        """Focal length of its lens."""
        return self.lens.focal_px

    @cached_property
    def centre_px(self) -> tuple[float, float]:
        """Column and row of its axis."""
        return self.lens.centre_px

    @cached_property
    def slopes(self) -> Floats:
        """The offset to the right of each column per metre ahead, (width,)."""
        return (self.columns - self.centre_px[0]) / self.focal_px

    @property
    def columns(self) -> NDArray[np.float32]:
        """The numbers of the columns, (width,)."""
        return _numbers(self.lens.width)

    def seen(self, point: tuple[float, float]) -> tuple[float, float]:
        """Return the distances to the right and ahead of a point of the floor plan."""
        x_m, y_m = point[0] - self.x_m, point[1] - self.y_m
        return x_m * self.right[0] + y_m * self.right[1], x_m * self.ahead[0] + y_m * self.ahead[1]

    def column(self, right_m: float, ahead_m: float) -> float:
        """Return the column of a point in front of the camera."""
        return self.centre_px[0] + self.focal_px * right_m / ahead_m

    def row(self, height_m: float, nearness: float) -> float:
        """Return the row of a point at a height, given the inverse of its distance ahead."""
        return self.centre_px[1] - self.focal_px * (height_m - self.z_m) * nearness

    def rows(self, height_m: float, nearness: Floats) -> NDArray[np.float64]:
        """Return the rows of points at a height, given the inverses of their distances ahead."""
        return np.asarray(self.centre_px[1] - self.focal_px * (height_m - self.z_m) * nearness)


@lru_cache(maxsize=8)
def _numbers(count: int) -> NDArray[np.float32]:
    return np.arange(count, dtype=np.float32)
