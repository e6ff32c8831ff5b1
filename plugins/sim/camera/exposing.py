"""What a camera's chip makes of what it sees."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def exposed(image: NDArray[np.uint8], exposure: float, noise: float, seed: int) -> NDArray[np.uint8]:
    """Return an image as a chip delivers it; what is too bright is white.

    Args:
        image: red, green and blue, (height, width, 3).
        exposure: factor on the grey levels.
        noise: standard deviation of normal noise that each number gets, in grey levels; 0 for none.
        seed: of the noise.
    """
    if exposure != 1.0:
        image = np.asarray(cv2.convertScaleAbs(image, alpha=exposure), dtype=np.uint8)
    if noise:
        generator = np.random.Generator(np.random.SFC64(seed))
        noisy = generator.standard_normal(image.shape, dtype=np.float32)
        noisy *= noise
        noisy += image
        image = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return image
