"""Mosaics: tiles with random motifs, so that each place on them is distinct."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .texture import row_blocks

_Image = NDArray[np.float32]

_KINDS: Final = 5
_FINE: Final = 128  # resolution of a motif along each side of a tile
_JOINT_DARK: Final = 0.45


def mosaic(
    columns: int, rows: int, size_m: tuple[float, float], tile_m: float, palette: _Image, generator: np.random.Generator
) -> _Image:
    """Return tiles, each with a random motif: a quarter disc, a disc, a ring, a triangle or a lozenge.

    The samples cover `size_m`, width and height. The palette has red, green and blue of each colour, (n, 3).
    """
    along = np.linspace(0, size_m[0] / tile_m, columns, dtype=np.float32)
    up = np.linspace(size_m[1] / tile_m, 0, rows, dtype=np.float32)
    column, row = _tiles(along), _tiles(up)
    tiles = int(row.max()) + 1, int(column.max()) + 1
    ground, other, motif = (generator.integers(0, most, tiles) for most in (len(palette), len(palette), 4 * _KINDS))
    other = np.where(other == ground, (other + 1) % len(palette), other)
    tone = 1 + 0.05 * generator.standard_normal((*tiles, 1), dtype=np.float32)
    x, y = along - column, up - row
    soft = tile_m / size_m[0] * (columns - 1)  # samples in a tile
    inside = np.clip(_depths() * np.float32(soft) + np.float32(0.5), 0, 1)
    joint_x, joint_y = _joint(x, soft), _joint(y, soft)
    first, second = palette[ground] * tone, palette[other] * tone
    colours = np.empty((rows, columns, 3), np.float32)
    for block in row_blocks(rows):
        at = np.ix_(row[block], column)
        share = inside[motif[at], _fine(y[block])[:, np.newaxis], _fine(x)[np.newaxis]][..., np.newaxis]
        joint = joint_y[block, np.newaxis] * joint_x[np.newaxis]
        colours[block] = np.clip((first[at] + (second - first)[at] * share) * joint[..., np.newaxis], 0, 255)
    return colours


def _tiles(places: _Image) -> NDArray[np.intp]:
    """Return the number of each place's tile; the last edge belongs to the last tile."""
    last = max(int(np.ceil(places.max() - 1e-4)) - 1, 0)
    return np.minimum(places.astype(np.intp), last)


def _fine(places: _Image) -> NDArray[np.intp]:
    return np.minimum(places * _FINE, _FINE - 1).astype(np.intp)


def _joint(places: _Image, soft: float) -> _Image:
    """Return the factor that darkens the edges of tiles, given places in tiles, 0..1."""
    from_edge = np.minimum(places, 1 - places)
    return np.asarray(1 - _JOINT_DARK * np.clip((0.025 - from_edge) * soft + 0.5, 0, 1), dtype=np.float32)


@cache
def _depths() -> _Image:
    """Return the depth of each place of a tile inside each motif, in tiles, negative outside: (motifs, y, x)."""
    middles = (np.arange(_FINE, dtype=np.float32) + 0.5) / _FINE
    x, y = (np.asarray(grid, dtype=np.float32) for grid in np.meshgrid(middles, middles))
    turns = ((x, y), (y, 1 - x), (1 - x, 1 - y), (1 - y, x))
    return np.array([depth for x, y in turns for depth in _kinds(x, y)], dtype=np.float32)


def _kinds(x: _Image, y: _Image) -> list[_Image]:
    from_middle = np.hypot(x - 0.5, y - 0.5)
    return [
        0.85 - np.hypot(x, y),
        0.32 - from_middle,
        0.1 - np.abs(from_middle - 0.3),
        (x - y) * np.float32(0.7),
        0.33 - (np.abs(x - 0.5) + np.abs(y - 0.5)) * np.float32(0.7),
    ]
