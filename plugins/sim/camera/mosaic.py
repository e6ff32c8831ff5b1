"""Mosaics: tiles with motifs by lot, so that each place on them looks different."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_Image = NDArray[np.float32]


def mosaic(
    columns: int, rows: int, size_m: tuple[float, float], tile_m: float, palette: _Image, generator: np.random.Generator
) -> _Image:
    """Return tiles, each with a motif by lot: a quarter disc, a disc, a ring, a triangle or a lozenge.

    Args:
        columns: number of samples along.
        rows: number of samples across.
        size_m: width and height that they cover.
        tile_m: size of a tile.
        palette: red, green and blue of each colour, (n, 3).
        generator: of what is drawn by lot.
    """
    along = np.linspace(0, size_m[0] / tile_m, columns, dtype=np.float32)[np.newaxis]
    up = np.linspace(size_m[1] / tile_m, 0, rows, dtype=np.float32)[:, np.newaxis]
    column = np.minimum(np.floor(along), np.ceil(along[0, -1] - 1e-4) - 1).astype(np.intp)
    row = np.minimum(np.floor(up), np.ceil(up[0, 0] - 1e-4) - 1).astype(np.intp)
    tiles = int(row.max()) + 1, int(column.max()) + 1
    ground, motif, kind, turn = (generator.integers(0, most, tiles) for most in (len(palette), len(palette), 5, 4))
    motif = np.where(motif == ground, (motif + 1) % len(palette), motif)
    x, y = along - column, up - row
    x, y = _turned(x, y, turn[row, column])
    soft = tile_m / size_m[0] * (columns - 1)  # samples in a tile
    inside = np.clip(_depth(x, y, kind[row, column]) * soft + 0.5, 0, 1)
    tone = 1 + 0.05 * generator.standard_normal(tiles, dtype=np.float32)
    colours = (
        palette[ground[row, column]] * (1 - inside)[..., np.newaxis]
        + palette[motif[row, column]] * inside[..., np.newaxis]
    )
    edge = np.minimum(np.minimum(x, 1 - x), np.minimum(y, 1 - y))
    joint = 1 - 0.45 * np.clip((0.025 - edge) * soft + 0.5, 0, 1)
    return np.asarray(np.clip(colours * (tone[row, column] * joint)[..., np.newaxis], 0, 255), dtype=np.float32)


def _turned(x: _Image, y: _Image, turn: NDArray[np.int64]) -> tuple[_Image, _Image]:
    """Return places in tiles that are turned by quarters."""
    x, y = np.broadcast_arrays(x, y)
    return np.choose(turn, [x, y, 1 - x, 1 - y]), np.choose(turn, [y, 1 - x, 1 - y, x])


def _depth(x: _Image, y: _Image, kind: NDArray[np.int64]) -> _Image:
    """Return how far inside its tile's motif each place is, in tiles; negative outside."""
    from_middle = np.hypot(x - 0.5, y - 0.5)
    motifs = [
        0.85 - np.hypot(x, y),
        0.32 - from_middle,
        0.1 - np.abs(from_middle - 0.3),
        (x - y) * 0.7,
        0.33 - (np.abs(x - 0.5) + np.abs(y - 0.5)) * 0.7,
    ]
    return np.asarray(np.choose(kind, motifs), dtype=np.float32)
