"""Draws the patterns of world files: the appearance of a surface in even light."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.device.world import SurfaceTexture, WorldModel

from .mosaic import mosaic
from .poster import poster
from .texture import row_blocks

Colours: TypeAlias = NDArray[np.float32]
"""Rows from the top, shape (height, width, 3), 0..255."""

_GAP_M: Final = 0.004


@dataclass(frozen=True)
class PatternCanvas:
    """The image of a pattern.

    Attributes:
        columns: number of samples along.
        rows: number of samples across.
        size_m: width and height in metres, from the first sample to the last.
        wraps: whether the right edge meets the left edge, as around a pillar.
    """

    columns: int
    rows: int
    size_m: tuple[float, float]
    generator: np.random.Generator
    wraps: bool = False

    @property
    def along_m(self) -> Colours:
        """Distance of each column from the left, (1, columns)."""
        return np.linspace(0, self.size_m[0], self.columns, dtype=np.float32)[np.newaxis]

    @property
    def up_m(self) -> Colours:
        """Height of each row over the lower edge, (rows, 1)."""
        return np.linspace(self.size_m[1], 0, self.rows, dtype=np.float32)[:, np.newaxis]

    def fitted(self, tile_m: float) -> float:
        """Return a tile's size, adjusted to a whole number of tiles if the canvas wraps."""
        return self.size_m[0] / max(1, round(self.size_m[0] / tile_m)) if self.wraps else tile_m

    def clouds(self, size_m: tuple[float, float]) -> Colours:
        """Return smooth noise of a grain size and standard deviation 1, (rows, columns)."""
        cells = [max(2, math.ceil(length / grain) + 1) for length, grain in zip(self.size_m, size_m, strict=True)]
        cells = [min(cell, most) for cell, most in zip(cells, (self.columns, self.rows), strict=True)]
        grid = self.generator.standard_normal((cells[1], cells[0]), dtype=np.float32)
        if self.wraps:
            grid[:, -1] = grid[:, 0]
        return np.asarray(cv2.resize(grid, (self.columns, self.rows), interpolation=cv2.INTER_LINEAR))

    def numbers(self, along_m: Colours, tile_m: float) -> NDArray[np.intp]:
        """Return the tile number at each place; modulo the tile count if the canvas wraps."""
        number: NDArray[np.intp] = np.floor(along_m / tile_m).astype(np.intp)
        return number % max(1, round(self.size_m[0] / tile_m)) if self.wraps else number

    def tones(self, row: NDArray[np.intp], column: NDArray[np.intp], spread: float) -> Colours:
        """Return a random brightness around 1 of each tile, given the tile numbers at each sample."""
        tones = 1 + spread * self.generator.standard_normal((row.max() + 1, column.max() + 1), dtype=np.float32)
        return np.asarray(tones[row, column])


def draw(texture: SurfaceTexture, canvas: PatternCanvas) -> Colours:
    """Return a texture of a world file, drawn on a canvas."""
    palette = np.array(texture.colours, dtype=np.float32)
    return _PATTERNS[texture.pattern](canvas, palette, texture.tile_m)


def _plain(canvas: PatternCanvas, palette: Colours, tile_m: float) -> Colours:
    del tile_m
    shade = 1 + 0.012 * canvas.clouds((0.4, 0.4)) + 0.008 * canvas.clouds((0.01, 0.01))
    return np.asarray(shade[..., np.newaxis] * palette[0])


def _plaster(canvas: PatternCanvas, palette: Colours, tile_m: float) -> Colours:
    rough = sum(share * canvas.clouds((tile_m * grain,) * 2) for share, grain in _PLASTER_GRAINS)
    slope = np.gradient(rough, axis=0) * canvas.rows / canvas.size_m[1] / 60  # lit from above
    shade = 1 + 0.012 * rough + np.clip(0.012 * slope, -0.05, 0.05)
    return np.asarray(shade[..., np.newaxis] * palette[0])


_PLASTER_GRAINS: Final = ((1.0, 2.0), (0.9, 0.6), (0.7, 0.2), (0.6, 0.07), (0.5, 0.025))


def _checker(canvas: PatternCanvas, palette: Colours, tile_m: float) -> Colours:
    tile_m = canvas.fitted(tile_m)
    column, row = canvas.numbers(canvas.along_m, tile_m), _rows(canvas, tile_m)
    index = (column + row) % len(palette)
    shade = canvas.tones(row, column, 0.02) * (1 + 0.01 * canvas.clouds((0.05, 0.05)))
    shade *= 1 - 0.35 * _joint(canvas.along_m, tile_m, canvas, 0) * np.ones_like(shade)
    shade *= 1 - 0.35 * _joint(canvas.up_m, tile_m, canvas, 1)
    return np.asarray(shade[..., np.newaxis] * palette[index])


def _stripes(canvas: PatternCanvas, palette: Colours, tile_m: float) -> Colours:
    tile_m = canvas.fitted(tile_m)
    column = canvas.numbers(canvas.along_m, tile_m)
    shade = 1 + 0.015 * canvas.clouds((0.6, 0.006)) + 0.01 * canvas.clouds((0.3, 0.3))
    shade *= 1 - 0.4 * _joint(canvas.along_m, tile_m, canvas, 0)
    return np.asarray(shade[..., np.newaxis] * palette[column % len(palette)])


def _planks(canvas: PatternCanvas, palette: Colours, tile_m: float) -> Colours:
    row = _rows(canvas, tile_m)
    shift_m = canvas.generator.random(row.max() + 1, dtype=np.float32)[row] * np.float32(tile_m * 8)
    length_m = canvas.fitted(tile_m * 8)
    grain = canvas.clouds((tile_m * 2.5, tile_m / 14))
    grain += 0.7 * canvas.clouds((tile_m, tile_m / 40))
    tones = canvas.tones(row, canvas.numbers(canvas.along_m + shift_m, length_m), 1.0)
    across = _joint(canvas.up_m, tile_m, canvas, 1)
    colours = np.empty((canvas.rows, canvas.columns, 3), np.float32)
    for block in row_blocks(canvas.rows):
        mix = np.clip(0.45 + 0.3 * (tones[block] - 1) + 0.16 * grain[block], 0, 1)[..., np.newaxis]
        gaps = np.maximum(_joint(canvas.along_m + shift_m[block], length_m, canvas, 0), across[block])
        colours[block] = (palette[0] * (1 - mix) + palette[-1] * mix) * (1 - 0.6 * gaps)[..., np.newaxis]
    return colours


def _bricks(canvas: PatternCanvas, palette: Colours, tile_m: float) -> Colours:
    tile_m, course_m = canvas.fitted(tile_m), tile_m * 0.4
    course = _rows(canvas, course_m)
    along_m = canvas.along_m + (course % 2).astype(np.float32) * np.float32(tile_m / 2)
    brick = canvas.numbers(along_m, tile_m)
    rough = 0.04 * canvas.clouds((0.015, 0.015)) + 0.03 * canvas.clouds((0.1, 0.1))
    shade = canvas.tones(course, brick, 0.11) + rough
    joint = np.maximum(
        _joint(along_m, tile_m, canvas, 0, tile_m * 0.05), _joint(canvas.up_m, course_m, canvas, 1, tile_m * 0.05)
    )[..., np.newaxis]
    return np.asarray(
        shade[..., np.newaxis] * palette[0] * (1 - joint) + (0.92 + rough)[..., np.newaxis] * palette[-1] * joint
    )


def _rows(canvas: PatternCanvas, tile_m: float) -> NDArray[np.intp]:
    """Return the tile row of each sample, from below, (rows, 1)."""
    return np.asarray(np.floor(canvas.up_m / tile_m), dtype=np.intp)


def _joint(place_m: Colours, tile_m: float, canvas: PatternCanvas, axis: int, width_m: float = _GAP_M) -> Colours:
    """Return 1 in the joints between tiles and 0 elsewhere, antialiased."""
    sample_m = canvas.size_m[axis] / ((canvas.columns, canvas.rows)[axis] - 1)
    from_joint_m = np.abs((place_m / tile_m + 0.5) % 1.0 - 0.5) * tile_m
    return np.asarray(np.clip((width_m / 2 - from_joint_m) / sample_m + 0.5, 0.0, 1.0))


def _mosaic(canvas: PatternCanvas, palette: Colours, tile_m: float) -> Colours:
    return mosaic(canvas.columns, canvas.rows, canvas.size_m, canvas.fitted(tile_m), palette, canvas.generator)


def _poster(canvas: PatternCanvas, palette: Colours, tile_m: float) -> Colours:
    del tile_m
    return poster(canvas.columns, canvas.rows, palette, canvas.generator)


_PATTERNS: Final[Mapping[str, Callable[[PatternCanvas, Colours, float], Colours]]] = MappingProxyType(
    {
        "plain": _plain,
        "checker": _checker,
        "stripes": _stripes,
        "planks": _planks,
        "bricks": _bricks,
        "plaster": _plaster,
        "mosaic": _mosaic,
        "poster": _poster,
    }
)


def albedo(model: WorldModel, name: str | None, canvas: PatternCanvas) -> Colours:
    """Return a texture of a world by its name; plain grey for None."""
    if name is None:
        return _plain(canvas, np.array([_GREY], dtype=np.float32), 1.0)
    return draw(model.textures[name], canvas)


_GREY: Final = (200.0, 200.0, 200.0)
