"""A slow camera that asks for each pixel what its rays meet: the truth that the renderer is held against.

It shares the renderer's solids and the finest versions of their textures, and nothing of its geometry.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plugins.sim.camera.eye import Eye
from plugins.sim.camera.movers import Mover
from plugins.sim.camera.scene import Scene
from plugins.sim.camera.solids import Block, Drum, Face, Plane, Solid
from plugins.sim.camera.texture import Mipmap

Array = NDArray[Any]


@dataclass
class Surface:
    """A surface that a ray may hit.

    Attributes:
        meet: how many times its direction each ray goes until it meets the surface, infinite where it does not.
        look: the colours of the surface at points, (n, 3).
    """

    meet: Callable[[Array, Array], Array]
    look: Callable[[Array], Array]


def cast(scene: Scene, movers: Sequence[Mover], eye: Eye, rays_per_side: int = 3) -> NDArray[np.uint8]:
    """Return what a camera sees, with so many rays along each side of a pixel."""
    width, height = eye.lens.width, eye.lens.height
    focal_px = width / 2 / math.tan(math.radians(eye.lens.fov_deg) / 2)
    surfaces = list(_surfaces(scene, movers))
    origin = np.array([eye.x_m, eye.y_m, eye.z_m])
    parts = (np.arange(rays_per_side) + 0.5) / rays_per_side
    total = np.zeros((height, width, 3))
    for part_x in parts:
        for part_y in parts:
            right = (np.arange(width) + part_x - width / 2) / focal_px
            up = (height / 2 - np.arange(height) - part_y) / focal_px
            directions = np.empty((height, width, 3))
            directions[..., 0] = math.cos(eye.yaw_rad) + right * math.sin(eye.yaw_rad)
            directions[..., 1] = math.sin(eye.yaw_rad) - right * math.cos(eye.yaw_rad)
            directions[..., 2] = up[:, np.newaxis]
            total += _colours(surfaces, origin, directions.reshape(-1, 3)).reshape(total.shape)
    return np.rint(total / rays_per_side**2).clip(0, 255).astype(np.uint8)


def depths(scene: Scene, movers: Sequence[Mover], eye: Eye) -> Array:
    """Return how far ahead each pixel's middle ray meets something, shape (height, width)."""
    width, height = eye.lens.width, eye.lens.height
    focal_px = width / 2 / math.tan(math.radians(eye.lens.fov_deg) / 2)
    right = (np.arange(width) + 0.5 - width / 2) / focal_px
    up = (height / 2 - np.arange(height) - 0.5) / focal_px
    directions = np.empty((height, width, 3))
    directions[..., 0] = math.cos(eye.yaw_rad) + right * math.sin(eye.yaw_rad)
    directions[..., 1] = math.sin(eye.yaw_rad) - right * math.cos(eye.yaw_rad)
    directions[..., 2] = up[:, np.newaxis]
    origin, rays = np.array([eye.x_m, eye.y_m, eye.z_m]), directions.reshape(-1, 3)
    met = [surface.meet(origin, rays) for surface in _surfaces(scene, movers)]
    nearest: Array = np.min(met, axis=0)
    return nearest.reshape(height, width)


def psnr_db(image: Array, truth: Array) -> float:
    """Return the peak signal-to-noise ratio between two images."""
    square = np.mean((image.astype(float) - truth) ** 2)
    return float(10 * math.log10(255**2 / square)) if square else math.inf


def _colours(surfaces: Sequence[Surface], origin: Array, directions: Array) -> Array:
    nearest = np.full(len(directions), np.inf)
    met = np.zeros(len(directions), dtype=int)
    for number, surface in enumerate(surfaces):
        distances = surface.meet(origin, directions)
        nearer = distances < nearest
        nearest[nearer], met[nearer] = distances[nearer], number
    assert np.isfinite(nearest).all(), "every ray meets something in a closed room"
    colours = np.empty_like(directions)
    for number, surface in enumerate(surfaces):
        if (here := met == number).any():
            colours[here] = surface.look(origin + directions[here] * nearest[here, np.newaxis])
    return colours


def _surfaces(scene: Scene, movers: Sequence[Mover]) -> Iterator[Surface]:
    solids, shadows = scene.placed(movers)
    yield Surface(lambda o, d: _level(o, d, 0.0), lambda p: _floor(scene.floor, shadows, p))
    yield Surface(lambda o, d: _level(o, d, scene.ceiling.height_m), lambda p: _plane_colours(scene.ceiling, p))
    for wall in scene.walls:
        yield _face(wall)
    for poster in scene.posters:
        yield _face(poster, 1 - 1e-9)
    for solid in (*scene.blocks, *scene.towers, *solids):
        yield from _solid(solid)


def _solid(solid: Solid) -> Iterator[Surface]:
    if isinstance(solid, Block):
        yield from map(_face, solid.faces)
        yield _top(solid.top, lambda points: _in_polygon(np.array(solid.corners), points))
        return
    for drum in solid.drums:
        yield _side(drum)
        yield _drum_top(drum)


def _drum_top(drum: Drum) -> Surface:
    return _top(drum.top, lambda points: np.hypot(*(points - drum.middle).T) <= drum.radius_m)


def _face(face: Face, nearness: float = 1.0) -> Surface:
    left, right = np.array(face.left), np.array(face.right)
    length_m = float(np.hypot(*(right - left)))
    along = (right - left) / length_m
    normal = np.array([along[1], -along[0]])

    def meet(origin: Array, directions: Array) -> Array:
        times = np.full(len(directions), np.inf)
        distance_m = float((left - origin[:2]) @ normal)
        towards = directions[:, 0] * normal[0] + directions[:, 1] * normal[1]
        ahead = np.flatnonzero(towards < 0)
        if distance_m >= 0:
            return times
        time = distance_m / towards[ahead]
        on = (origin[:2] - left) @ along + time * (directions[ahead, 0] * along[0] + directions[ahead, 1] * along[1])
        up = origin[2] + time * directions[ahead, 2]
        inside = (on >= 0) & (on <= length_m) & (up >= face.bottom_m) & (up <= face.top_m)
        times[ahead[inside]] = time[inside] * nearness
        return times

    def look(points: Array) -> Array:
        on = (points[:, :2] - left) @ along + face.offset_m
        return face.gain * _sampled(face.texture, on, face.top_m - points[:, 2])

    return Surface(meet, look)


def _level(origin: Array, directions: Array, height_m: float) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        times = (height_m - origin[2]) / directions[:, 2]
    return np.where(times > 0, times, np.inf)


def _top(plane: Plane, is_on: Callable[[Array], Array]) -> Surface:
    def meet(origin: Array, directions: Array) -> Array:
        times = np.full(len(directions), np.inf)
        if origin[2] > plane.height_m:
            below = np.flatnonzero(directions[:, 2] < 0)
            time = (plane.height_m - origin[2]) / directions[below, 2]
            on = is_on(origin[:2] + directions[below, :2] * time[:, np.newaxis])
            times[below[on]] = time[on]
        return times

    return Surface(meet, lambda points: _plane_colours(plane, points))


def _in_polygon(corners: Array, points: Array) -> Array:
    inside = np.ones(len(points), dtype=bool)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        edge, away = end - start, points - start
        inside &= edge[0] * away[:, 1] - edge[1] * away[:, 0] >= 0
    return inside


def _side(drum: Drum) -> Surface:
    def meet(origin: Array, directions: Array) -> Array:
        times = np.full(len(directions), np.inf)
        away = origin[:2] - drum.middle
        a = directions[:, 0] ** 2 + directions[:, 1] ** 2
        b = directions[:, 0] * away[0] + directions[:, 1] * away[1]
        inner = b**2 - a * (away @ away - drum.radius_m**2)
        through = np.flatnonzero((inner >= 0) & (b < 0))
        time = (-b[through] - np.sqrt(inner[through])) / a[through]
        up = origin[2] + directions[through, 2] * time
        met = (time > 0) & (up >= drum.bottom_m) & (up <= drum.height_m)
        times[through[met]] = time[met]
        return times

    def look(points: Array) -> Array:
        offset = points[:, :2] - drum.middle
        facing = np.arctan2(offset[:, 1], offset[:, 0])
        around = np.mod(facing - drum.yaw_rad + math.pi, 2 * math.pi) * drum.radius_m
        colours = _sampled(drum.side, around, drum.height_m - points[:, 2])
        if drum.gains is not None:
            steps = np.linspace(-math.pi, math.pi, len(drum.gains))
            colours *= np.interp(facing, steps, drum.gains)[:, np.newaxis]
        return np.minimum(colours, 255)

    return Surface(meet, look)


def _floor(plane: Plane, shadows: Sequence[Plane], points: Array) -> Array:
    colours = _plane_colours(plane, points)
    for shadow in shadows:
        colours = colours * _plane_colours(shadow, points) / 255
    return colours


def _plane_colours(plane: Plane, points: Array) -> Array:
    away = points[:, :2] - plane.middle
    cos, sin = math.cos(plane.yaw_rad), math.sin(plane.yaw_rad)
    half_x_m, half_y_m = plane.texture.size_m[0] / 2, plane.texture.size_m[1] / 2
    along, up = away @ (cos, sin), away @ (-sin, cos)
    return np.minimum(plane.gain * _sampled(plane.texture, along + half_x_m, half_y_m - up), 255)


def _sampled(texture: Mipmap, along_m: Array, down_m: Array) -> Array:
    """Return the colours of a texture at places, in metres from its upper left corner, between its samples too."""
    image = texture.finest[..., :3]
    rows, columns = image.shape[:2]
    x = np.clip(along_m / texture.size_m[0] * (columns - 1), 0, columns - 1)
    y = np.clip(down_m / texture.size_m[1] * (rows - 1), 0, rows - 1)
    left, top = np.minimum(x.astype(int), columns - 2), np.minimum(y.astype(int), rows - 2)
    part_x, part_y = (x - left)[:, np.newaxis], (y - top)[:, np.newaxis]
    upper = image[top, left] * (1 - part_x) + image[top, left + 1] * part_x
    lower = image[top + 1, left] * (1 - part_x) + image[top + 1, left + 1] * part_x
    return np.asarray(upper * (1 - part_y) + lower * part_y)
