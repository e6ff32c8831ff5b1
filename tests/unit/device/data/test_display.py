"""Values as people see them: small arrays as numbers, pictures as PNG."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from eal_actors.device.data import EALData


def test_a_pose_shows_its_numbers() -> None:
    pose = EALData.of(np.array([-1.5, 0.25, 1 / 3]), frame_id="map")
    assert str(pose) == "EALData(double[3] [-1.5, 0.25, 0.333333], frame_id='map')"
    assert "[[1, 2], [3, 4]]" in repr(EALData.of(np.array([[1, 2], [3, 4]], np.int32)))


@pytest.mark.parametrize("shape", [(3, 5, 3), (4, 2), (2, 3, 1)])
def test_a_picture_is_a_png_that_others_read(shape: tuple[int, ...]) -> None:
    pixels = np.arange(np.prod(shape), dtype=np.uint8).reshape(shape)
    png = EALData.of(pixels)._repr_png_()
    assert png is not None
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(png))), pixels.squeeze())


@pytest.mark.parametrize(
    "value", [1.5, "text", [1, 2], np.zeros((2, 2)), np.zeros((2, 2, 4), np.uint8), np.zeros(3, np.uint8)]
)
def test_other_values_are_no_pictures(value: object) -> None:
    assert EALData.of(value)._repr_png_() is None
