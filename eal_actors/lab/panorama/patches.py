"""Frames projected onto the cylinder for comparisons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.lab.panorama.cylinder import Attitude, Image, Mask, resampled
from eal_actors.lab.panorama.parallax import TurnedCamera


@dataclass(frozen=True, slots=True)
class Patch:
    """A projected frame for comparisons, (h, w), with its axis in the centre; `reaches` is the mask of the frame."""

    grey: NDArray[np.uint8]
    reaches: Mask
    colours: Image
    px_per_rad: float

    @property
    def centre_px(self) -> tuple[float, float]:
        """Column and row of the axis."""
        height, width = self.grey.shape
        return (width - 1) / 2, (height - 1) / 2


def patch_of(frame: Image, camera: TurnedCamera, yaw_rad: float) -> Patch:
    """Return the whole frame, projected with as many pixels per radian as it has about its axis."""
    lens = camera.lens
    px_per_rad = lens.focal_px
    width = int(2 * lens.half_view_rad * px_per_rad)
    height = lens.height
    right_rad = (np.arange(width) - (width - 1) / 2) / px_per_rad
    down = (np.arange(height) - (height - 1) / 2) / px_per_rad
    x, y, reaches = camera.pixels(right_rad, down[:, np.newaxis], Attitude(yaw_rad))
    colours = resampled(frame, x, y)
    grey: NDArray[Any] = cv2.cvtColor(colours, cv2.COLOR_RGB2GRAY)
    return Patch(np.asarray(grey, np.uint8), reaches, colours, px_per_rad)
