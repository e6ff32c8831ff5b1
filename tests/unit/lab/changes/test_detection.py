"""Changes between pictures: objects that appear and disappear, but not noise, light or small displacements."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.changes.detection import find_changes

Image = NDArray[np.uint8]


def scene(seed: int = 1) -> Image:
    """A room full of edges: rectangles of many colours."""
    generator = np.random.default_rng(seed)
    image = np.full((480, 640, 3), 160, np.uint8)
    for _ in range(60):
        x, y = (int(generator.integers(0, limit)) for limit in (640, 480))
        size = [int(generator.integers(20, 120)) for _ in range(2)]
        colour = [int(generator.integers(40, 220)) for _ in range(3)]
        cv2.rectangle(image, (x, y), (x + size[0], y + size[1]), colour, -1)
    return image


def seen(
    image: Image, seed: int, shift_px: tuple[float, float] = (0, 0), scale: float = 1.0, gain: float = 1.0
) -> Image:
    """The same from a bit aside, in other light, with noise of 5 grey levels."""
    matrix = np.array([[scale, 0, shift_px[0]], [0, scale, shift_px[1]]], np.float64)
    moved = cv2.warpAffine(image, matrix, (640, 480), borderMode=cv2.BORDER_REFLECT).astype(np.float64)
    noise = np.random.default_rng(seed).normal(0, 5, moved.shape)
    return np.asarray(np.clip(moved * gain + noise, 0, 255), np.uint8)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("shift_px", "scale", "gain"), [((0, 0), 1.0, 1.0), ((9.3, -4.6), 1.0, 0.9), ((-12, 3), 1.015, 1.1)]
)
def test_nothing_has_changed(seed: int, shift_px: tuple[float, float], scale: float, gain: float) -> None:
    room = scene(seed)
    changes = find_changes(seen(room, seed), seen(room, seed + 100, shift_px, scale, gain))
    assert changes.boxes == ()
    assert changes.share == 0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("has_come", [True, False])
def test_a_thing_that_has_come_or_gone_is_framed(seed: int, has_come: bool) -> None:
    without = scene(seed)
    thing = without.copy()
    cv2.rectangle(thing, (250, 200), (350, 300), (255, 255, 255), -1)
    cv2.circle(thing, (300, 250), 30, (0, 0, 0), -1)
    before, after = (without, thing) if has_come else (thing, without)
    changes = find_changes(seen(before, seed), seen(after, seed + 100, (6.5, 2.0)))
    assert len(changes.boxes) == 1
    x, y, width, height = changes.boxes[0]
    assert (x <= 285, y <= 235, x + width >= 315, y + height >= 265) == (True,) * 4, "its middle is within"
    assert max(width, height) < 180


def test_pictures_of_different_shapes_are_refused() -> None:
    with pytest.raises(ArgumentError, match="must have one shape"):
        find_changes(scene(), np.zeros((240, 320, 3), np.uint8))


def test_a_picture_that_is_too_small_is_refused() -> None:
    small = np.zeros((48, 640, 3), np.uint8)
    with pytest.raises(ArgumentError, match="at least 64 pixels"):
        find_changes(small, small)
