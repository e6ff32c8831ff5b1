"""Renders what a camera sees."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from .culling import may_be_seen
from .eye import Eye
from .flat import block_layers, face_layers, fill_plane, near_plane
from .layers import Layer, Rect
from .movers import Mover
from .order import Seen, far_to_near
from .round import tower_layers
from .scene import Scene
from .solids import Plane, Tower
from .texture import Image


def render(scene: Scene, movers: Sequence[Mover], eye: Eye) -> NDArray[np.uint8]:
    """Return what a camera sees, shape (height, width, 3): red, green and blue, rows from the top.

    The same arguments give the same image.

    Args:
        scene: what does not move.
        movers: the robots and boxes, without the robot that carries the camera.
        eye: the camera, inside the room.
    """
    moving, shadows = scene.placed([mover for mover in movers if may_be_seen(eye, mover)])
    walls, posters, *faces_of_blocks = scene.faces.in_view(eye)
    solids: list[Seen] = [(tower, tower_layers(eye, tower)) for tower in scene.towers]
    for block, faces in zip(scene.blocks, faces_of_blocks, strict=True):
        solids.append((block, block_layers(eye, block, faces)))
    for mover in moving:
        layers = tower_layers(eye, mover) if isinstance(mover, Tower) else block_layers(eye, mover, mover.faces)
        solids.append((mover, layers))
    ordered = far_to_near(eye, [(solid, layers) for solid, layers in solids if layers])
    shown, horizon = _visible(eye, ordered)
    wall_layers = face_layers(eye, walls, closed=True)
    poster_layers = [layer for poster in posters for layer in face_layers(eye, [poster])]
    image = np.empty((eye.lens.height, eye.lens.width, 4), np.uint8)
    _paint_floor_and_ceiling(image, scene, eye, wall_layers, shadows)
    for layer in (*wall_layers, *poster_layers):
        if _rises_above([layer], horizon):
            layer.paint(image)
    for layers in shown:
        for layer in layers:
            layer.paint(image)
    return cv2.cvtColor(image, cv2.COLOR_RGBA2RGB)  # type: ignore[return-value]


def _visible(eye: Eye, ordered: Sequence[Seen]) -> tuple[list[list[Layer]], NDArray[np.float64]]:
    """Drop what is hidden whole.

    All solids stand on the floor, so in one column a nearer one reaches lower than a farther one: the farther one is
    hidden there if it does not reach higher.

    Returns:
        The layers of each solid that is shown, from far to near, and the highest row that is covered in each column.
    """
    horizon = np.full(eye.lens.width, np.inf)
    shown = []
    for _, layers in reversed(ordered):
        if _rises_above(layers, horizon):
            shown.append(layers)
            for layer in layers:
                inner = slice(layer.columns.start + 1, layer.columns.stop - 1)
                np.minimum(horizon[inner], layer.tops[1:-1] + 0.5, out=horizon[inner])
    return shown[::-1], horizon


def _rises_above(layers: Iterable[Layer], horizon: NDArray[np.float64]) -> bool:
    return any(bool((np.maximum(layer.tops, -0.5) < horizon[layer.columns]).any()) for layer in layers)


def _paint_floor_and_ceiling(
    image: Image, scene: Scene, eye: Eye, walls: list[Layer], shadows: Iterable[Plane]
) -> None:
    """Paint both as far as the walls leave them free, and what darkens the floor."""
    width, height = eye.lens.width, eye.lens.height
    first_floor_row = max(math.floor(min(layer.bottoms.min() for layer in walls)), math.floor(eye.centre_px[1]) + 1)
    if first_floor_row < height:
        floor = Rect(0, width, first_floor_row, height)
        fill_plane(eye, scene.floor, floor, image[floor.top :])
        for shadow in shadows:
            _paint_shadow(image, eye, shadow, floor)
    last_ceiling_row = min(math.ceil(max(layer.tops.max() for layer in walls)), math.ceil(eye.centre_px[1]) - 1)
    if last_ceiling_row >= 0:
        ceiling = Rect(0, width, 0, last_ceiling_row + 1)
        fill_plane(eye, scene.ceiling, ceiling, image[: ceiling.bottom])


def _paint_shadow(image: Image, eye: Eye, shadow: Plane, floor: Rect) -> None:
    """Darken the floor."""
    half_m = max(shadow.texture.size_m) / 2
    right_m, ahead_m = eye.seen(shadow.middle)
    if ahead_m + half_m <= 0:
        return
    corners = [(right_m + x * half_m, ahead_m + y * half_m) for x in (-1, 1) for y in (-1, 1)]
    rect = floor
    if ahead_m - half_m > 0.01:
        columns = [eye.column(*corner) for corner in corners]
        rows = eye.rows(0.0, 1 / np.array([ahead_m + half_m, ahead_m - half_m]))
        rect = Rect(
            max(math.floor(min(columns)), floor.left),
            min(math.ceil(max(columns)) + 1, floor.right),
            max(math.floor(rows[0]), floor.top),
            min(math.ceil(rows[1]) + 1, floor.bottom),
        )
    if rect.left < rect.right and rect.top < rect.bottom:
        part = image[rect.top : rect.bottom, rect.left : rect.right]
        cv2.multiply(part, near_plane(eye, shadow, rect), dst=part, scale=1 / 255)
