"""Renders camera images, and applies exposure and noise."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from .eye import Eye
from .flat import block_layers, face_layers, fill_plane, near_plane
from .layers import Layer, Rect
from .movers import Mover
from .round import tower_layers
from .scene import Scene
from .solids import Block, Plane, Tower
from .texture import Image
from .visibility import Seen, far_to_near, may_be_seen


def render(scene: Scene, movers: Sequence[Mover], eye: Eye) -> NDArray[np.uint8]:
    """Return a camera's image, shape (height, width, 3): red, green and blue, rows from the top.

    The same arguments give the same image. The movers do not include the robot that carries the camera.
    """
    moving, shadows = scene.placed([mover for mover in movers if may_be_seen(eye, mover)])
    walls, posters, *faces_of_blocks = scene.faces.in_view(eye)
    towers = [*scene.towers, *(mover for mover in moving if isinstance(mover, Tower))]
    solids: list[Seen] = list(zip(towers, tower_layers(eye, towers), strict=True))
    blocks = [*zip(scene.blocks, faces_of_blocks, strict=True)]
    blocks += [(mover, list(mover.faces)) for mover in moving if isinstance(mover, Block)]
    solids += [(block, block_layers(eye, block, faces)) for block, faces in blocks]
    ordered = far_to_near(eye, [(solid, layers) for solid, layers in solids if layers])
    shown, horizon = _visible(eye, ordered)
    wall_layers = face_layers(eye, walls, closed=True)
    poster_layers = [layer for poster in posters for layer in face_layers(eye, [poster])]
    image = np.empty((eye.lens.height, eye.lens.width, 4), np.uint8)
    _paint_floor_and_ceiling(image, scene, eye, wall_layers, shadows)
    flat = [layer for layer in (*wall_layers, *poster_layers) if _rises_above(layer, horizon)]
    for layer in itertools.chain(flat, *shown):
        layer.paint(image)
    return cv2.cvtColor(image, cv2.COLOR_RGBA2RGB)  # type: ignore[return-value]


def _visible(eye: Eye, ordered: Sequence[Seen]) -> tuple[list[list[Layer]], NDArray[np.float32]]:
    """Drop solids that are completely hidden.

    All solids stand on the floor, so in one column a nearer solid reaches lower than a farther one. The farther one is
    hidden there if it does not reach higher.

    Returns:
        The layers of each visible solid, from far to near, and the highest covered row in each column.
    """
    horizon = np.full(eye.lens.width, np.inf, np.float32)
    shown = []
    for _, layers in reversed(ordered):
        if any(_rises_above(layer, horizon) for layer in layers):
            shown.append(layers)
            for layer in layers:
                inner = horizon[layer.first + 1 : layer.first + len(layer.tops) - 1]
                np.minimum(inner, layer.tops[1:-1], out=inner)
    return shown[::-1], horizon


def _rises_above(layer: Layer, horizon: NDArray[np.float32]) -> bool:
    covered, tops = horizon[layer.first : layer.first + len(layer.tops)], layer.tops
    if any(max(tops[at], -0.5) < covered[at] + 0.5 for at in (0, -1)):  # the usual case
        return True
    return bool((np.maximum(tops, -0.5) < covered + 0.5).any())


def _paint_floor_and_ceiling(
    image: Image, scene: Scene, eye: Eye, walls: list[Layer], shadows: Iterable[Plane]
) -> None:
    """Paint both where the walls do not cover them, and the shadows on the floor."""
    width, height = eye.lens.width, eye.lens.height
    first_floor_row = max(math.floor(min(layer.extent[2] for layer in walls)), math.floor(eye.centre_px[1]) + 1)
    if first_floor_row < height:
        floor = Rect(0, width, first_floor_row, height)
        fill_plane(eye, scene.floor, floor, image[floor.top :])
        for shadow in shadows:
            _paint_shadow(image, eye, shadow, floor)
    last_ceiling_row = min(math.ceil(max(layer.extent[1] for layer in walls)), math.ceil(eye.centre_px[1]) - 1)
    if last_ceiling_row >= 0:
        ceiling = Rect(0, width, 0, last_ceiling_row + 1)
        fill_plane(eye, scene.ceiling, ceiling, image[: ceiling.bottom])


def _paint_shadow(image: Image, eye: Eye, shadow: Plane, floor: Rect) -> None:
    """Darken the floor."""
    half_m = max(shadow.texture.size_m) / 2
    right_m, ahead_m = eye.seen(shadow.middle)
    if ahead_m + half_m <= 0:
        return
    rect = floor
    near_m, far_m = ahead_m - half_m, ahead_m + half_m
    if near_m > 0.01:
        left_m, right_m = right_m - half_m, right_m + half_m
        rect = Rect(
            max(math.floor(eye.column(left_m, near_m if left_m < 0 else far_m)), floor.left),
            min(math.ceil(eye.column(right_m, near_m if right_m > 0 else far_m)) + 1, floor.right),
            max(math.floor(eye.row(0.0, 1 / far_m)), floor.top),
            min(math.ceil(eye.row(0.0, 1 / near_m)) + 1, floor.bottom),
        )
    if rect.left < rect.right and rect.top < rect.bottom:
        part = image[rect.top : rect.bottom, rect.left : rect.right]
        cv2.multiply(part, near_plane(eye, shadow, rect), dst=part, scale=1 / 255)


def expose(image: NDArray[np.uint8], exposure: float, noise: float, seed: int) -> NDArray[np.uint8]:
    """Return the image of a sensor with an exposure and noise, clipped at white.

    Args:
        image: red, green and blue, (height, width, 3).
        exposure: factor on the grey levels.
        noise: standard deviation of normal noise on each colour value, in grey levels; 0 for none.
        seed: seed of the noise.
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
