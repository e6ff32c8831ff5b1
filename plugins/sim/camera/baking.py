"""Bakes the textures of fixed surfaces: patterns with the room's light and ambient occlusion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.device.world import WorldModel

from .eye import Floats
from .light import RoomLight
from .patterns import Colours, PatternCanvas, albedo
from .solids import Face, Plane, Point
from .texture import Image, Mipmap, row_blocks, samples

FLOOR_PER_M, WALL_PER_M, CEILING_PER_M, SOLID_PER_M, POSTER_PER_M = 250.0, 180.0, 90.0, 220.0, 420.0
_LIGHT_PER_M: Final = 6.0  # samples of the light per metre
_CORNER_M, _CORNER_DARK = 0.16, 0.22
_FOOT_M, _FOOT_DARK = 0.14, 0.3
_BLOCKED: Final = 0.75  # of a lamp's light in a shadow: the walls reflect the rest
_LAMP_M: Final = 0.16
_TAPE_M: Final = 0.04


class TextureBaker:
    """Creates the textures of one world.

    Args:
        detail: factor on the samples in a metre; under 1 for large worlds.

    Thread: one.
    """

    def __init__(self, model: WorldModel, light: RoomLight, detail: float) -> None:
        self._model = model
        self._light = light
        self._detail = detail
        self._made = 0

    def canvas(self, size_m: tuple[float, float], per_m: float, *, wraps: bool = False) -> PatternCanvas:
        """Return an empty canvas with its own random generator."""
        self._made += 1
        generator = np.random.default_rng([self._model.seed, self._made])
        columns, rows = (samples(length_m, per_m * self._detail) for length_m in size_m)
        return PatternCanvas(columns, rows, size_m, generator, wraps)

    def face(
        self, left: Point, right: Point, heights_m: tuple[float, float], texture: str | None, per_m: float
    ) -> Face:
        """Return a lit upright rectangle, from one height over the floor to another."""
        bottom_m, top_m = heights_m
        canvas = self.canvas((math.dist(left, right), top_m - bottom_m), per_m)
        bare = Face(left, right, bottom_m, top_m, Mipmap(np.zeros((2, 2, 4), np.uint8), canvas.size_m))
        colours = albedo(self._model, texture, canvas)
        shares, ups = _grid(canvas.size_m)
        points = np.empty((len(ups), len(shares), 3))
        points[..., :2] = np.asarray(left) + (shares * canvas.size_m[0])[np.newaxis, :, np.newaxis] * bare.along
        points[..., 2] = top_m - (ups * canvas.size_m[1])[:, np.newaxis]
        gain = self._light.gain(points.reshape(-1, 3), np.array([*bare.normal, 0.0])).reshape(points.shape[:2])
        dark = 1 - _FOOT_DARK * np.exp(-(canvas.up_m + bottom_m) / _FOOT_M)
        return Face(left, right, bottom_m, top_m, Mipmap(lit(colours, gain, dark), canvas.size_m))

    def wall(self, left: Point, right: Point) -> Face:
        """Return a lit wall of the room, dark in its corners."""
        height_m = self._model.height_m
        plain = self.face(left, right, (0.0, height_m), self._model.surfaces.walls, WALL_PER_M)
        length_m = plain.texture.size_m[0]
        rows, columns = plain.texture.finest.shape[:2]
        along_m = np.linspace(0, length_m, columns)[np.newaxis]
        up_m = np.linspace(height_m, 0, rows)[:, np.newaxis]
        dark = _corner(along_m) * _corner(length_m - along_m) * _corner(height_m - up_m)
        image = np.asarray(plain.texture.finest * dark[..., np.newaxis], dtype=np.uint8)
        return Face(left, right, 0.0, height_m, Mipmap(image, plain.texture.size_m))

    def ceiling(self) -> Plane:
        """Return the ceiling with its lamps on it."""
        size_m = self._model.size_m
        canvas = self.canvas(size_m, CEILING_PER_M)
        colours = albedo(self._model, self._model.surfaces.ceiling, canvas)
        points, shape = _level(size_m, self._model.height_m)
        gain = self._light.gain(points, np.array([0.0, 0.0, -1.0])).reshape(shape)
        image = lit(colours, gain, self._room_corners(canvas)).astype(np.float32)
        x_m, y_m = canvas.along_m - size_m[0] / 2, canvas.up_m - size_m[1] / 2
        for lamp in self._light.lamps:
            away_m = np.hypot(x_m - lamp.x_m, y_m - lamp.y_m)
            glow = np.clip((_LAMP_M - away_m) * 60, 0, 1) + 0.35 * np.exp(-np.maximum(away_m - _LAMP_M, 0) / 0.25)
            image += np.clip(glow, 0, 1)[..., np.newaxis] * (255 - image)
        return Plane(self._model.height_m, (0.0, 0.0), 0.0, Mipmap(image.astype(np.uint8), size_m))

    def floor(self, outlines: Sequence[tuple[Sequence[Point], float]]) -> Plane:
        """Return the floor, with the shadows of objects, each with its corners and its height."""
        size_m = self._model.size_m
        canvas = self.canvas(size_m, FLOOR_PER_M)
        colours = albedo(self._model, self._model.surfaces.floor, canvas)
        self._dig(colours, canvas)
        points, shape = _level(size_m, 0.0, 4 * _LIGHT_PER_M)
        lux = self._light.lux(points, np.array([0.0, 0.0, 1.0])).reshape(shape)
        for lamp in self._light.lamps:
            alone = _lamp_lux(points, lamp.x_m, lamp.y_m, lamp.z_m, lamp.lumens).reshape(shape)
            lux -= alone * _BLOCKED * _shade(size_m, shape, (lamp.x_m, lamp.y_m, lamp.z_m), outlines)
        gain = self._light.factor(lux) * _contact(size_m, shape, outlines)
        return Plane(0.0, (0.0, 0.0), 0.0, Mipmap(lit(colours, gain, self._room_corners(canvas)), size_m))

    def _dig(self, colours: Colours, canvas: PatternCanvas) -> None:
        """Paint the drops: dark holes, their edges marked with yellow tape."""
        x_m, y_m = canvas.along_m - canvas.size_m[0] / 2, canvas.up_m - canvas.size_m[1] / 2
        for drop in self._model.drops:
            yaw_rad = math.radians(drop.yaw_deg)
            along = np.abs((x_m - drop.x_m) * math.cos(yaw_rad) + (y_m - drop.y_m) * math.sin(yaw_rad))
            across = np.abs((y_m - drop.y_m) * math.cos(yaw_rad) - (x_m - drop.x_m) * math.sin(yaw_rad))
            outside_m = np.maximum(along - drop.size_m[0] / 2, across - drop.size_m[1] / 2)
            colours[outside_m < _TAPE_M] = (225, 190, 40)
            colours[outside_m < 0] = (14, 13, 12)

    def _room_corners(self, canvas: PatternCanvas) -> Colours:
        along_m, up_m = canvas.along_m, canvas.up_m
        dark = _corner(along_m) * _corner(canvas.size_m[0] - along_m) * _corner(up_m) * _corner(canvas.size_m[1] - up_m)
        return np.asarray(dark, dtype=np.float32)

    def top(
        self, middle: Point, size_m: tuple[float, float], yaw_rad: float, height_m: float, texture: str | None
    ) -> Plane:
        """Return the lit top of a solid, a rectangle round it."""
        canvas = self.canvas(size_m, SOLID_PER_M)
        colours = albedo(self._model, texture, canvas)
        gain = self._light.gain(np.array([[*middle, height_m]]), np.array([0.0, 0.0, 1.0]))
        return Plane(height_m, middle, yaw_rad, Mipmap(lit(colours, gain[np.newaxis]), size_m))

    def side(self, middle: Point, radius_m: float, height_m: float, colours: Colours, canvas: PatternCanvas) -> Mipmap:
        """Return the lit side of a pillar, unrolled."""
        turns = np.linspace(-math.pi, math.pi, 49)
        normals = np.stack([np.cos(turns), np.sin(turns), np.zeros_like(turns)], axis=1)
        heights_m = np.linspace(height_m, 0, 12)
        points = np.empty((12, 49, 3))
        points[..., :2] = np.asarray(middle) + radius_m * normals[:, :2]
        points[..., 2] = heights_m[:, np.newaxis]
        gain = self._light.gain(points.reshape(-1, 3), np.tile(normals, (12, 1))).reshape(12, 49)
        dark = 1 - _FOOT_DARK * np.exp(-canvas.up_m / _FOOT_M)
        return Mipmap(lit(colours, gain, dark), canvas.size_m)


def lit(colours: Colours, gain: Floats, dark: Floats | float = 1.0) -> Image:
    """Return colours with a light, given on a coarser grid, and a darkening of each sample."""
    rows, columns = colours.shape[:2]
    steps_y, steps_x = (
        np.linspace(0, count - 1, size, dtype=np.float32)
        for count, size in zip(gain.shape, (rows, columns), strict=True)
    )
    gain = gain.astype(np.float32)
    dark = np.broadcast_to(np.asarray(dark, np.float32), (rows, columns))
    image = np.full((rows, columns, 4), 255, np.uint8)
    for block in row_blocks(rows):
        shape = block.stop - block.start, columns
        maps = (
            np.broadcast_to(steps_x, shape).copy(),
            np.broadcast_to(steps_y[block, np.newaxis], shape).copy(),
        )
        factor = cv2.remap(gain, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) * dark[block]
        image[block, :, :3] = np.clip(colours[block] * factor[..., np.newaxis] + 0.5, 0, 255)
    return image


def _corner(away_m: Floats) -> NDArray[np.floating[Any]]:
    return np.asarray(1 - _CORNER_DARK * np.exp(-away_m / _CORNER_M))


def _grid(size_m: tuple[float, float], per_m: float = _LIGHT_PER_M) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the shares along and down at which light is computed."""
    along, down = (np.linspace(0, 1, max(2, math.ceil(length_m * per_m) + 1)) for length_m in size_m)
    return along, down


def _level(
    size_m: tuple[float, float], height_m: float, per_m: float = _LIGHT_PER_M
) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Return the points of the room's plan at which light is computed, (n, 3), and the numbers of rows and columns."""
    along, down = _grid(size_m, per_m)
    points = np.full((len(down), len(along), 3), height_m)
    points[..., 0] = (along - 0.5) * size_m[0]
    points[..., 1] = (0.5 - down[:, np.newaxis]) * size_m[1]
    return points.reshape(-1, 3), (len(down), len(along))


def _lamp_lux(points: NDArray[np.float64], x_m: float, y_m: float, z_m: float, lumens: float) -> NDArray[np.float64]:
    square_m2 = (points[:, 0] - x_m) ** 2 + (points[:, 1] - y_m) ** 2 + z_m**2
    return np.asarray(lumens / (4 * math.pi) * z_m / square_m2**1.5)


def _shade(
    size_m: tuple[float, float],
    shape: tuple[int, int],
    lamp_m: tuple[float, float, float],
    outlines: Sequence[tuple[Sequence[Point], float]],
) -> NDArray[np.float32]:
    """Return the shadow of a lamp on the floor: 1 in the shadow, 0 outside, with soft edges."""
    mask = np.zeros(shape, np.float32)
    lamp_x, lamp_y, lamp_z = lamp_m
    for corners, height_m in outlines:
        stretch = lamp_z / max(lamp_z - height_m, 0.2)
        far = [(lamp_x + (x - lamp_x) * stretch, lamp_y + (y - lamp_y) * stretch) for x, y in corners]
        hull = cv2.convexHull(np.array([*corners, *far], dtype=np.float32))
        cv2.fillConvexPoly(mask, _on_grid(np.asarray(hull[:, 0], np.float64), size_m, shape), 1.0, cv2.LINE_8, _SHIFT)
    return np.asarray(cv2.GaussianBlur(mask, (0, 0), 2.5))


def _contact(
    size_m: tuple[float, float], shape: tuple[int, int], outlines: Sequence[tuple[Sequence[Point], float]]
) -> NDArray[np.float64]:
    """Return the darkening of the floor near objects on it."""
    free = np.full(shape, 255, np.uint8)
    for corners, _ in outlines:
        cv2.fillConvexPoly(free, _on_grid(np.array(corners), size_m, shape), 0, cv2.LINE_8, _SHIFT)
    away_m = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * size_m[0] / (shape[1] - 1)
    return np.asarray(1 - _FOOT_DARK * np.exp(-away_m / _FOOT_M))


def _on_grid(points: Floats, size_m: tuple[float, float], shape: tuple[int, int]) -> NDArray[np.int32]:
    columns = (points[:, 0] / size_m[0] + 0.5) * (shape[1] - 1)
    rows = (0.5 - points[:, 1] / size_m[1]) * (shape[0] - 1)
    return np.asarray(np.rint(np.stack([columns, rows], axis=1) * (1 << _SHIFT)), dtype=np.int32)


_SHIFT: Final = 4
