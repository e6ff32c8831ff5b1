"""Posters: a heading, a picture of simple shapes, and small print, so that each place on them is distinct."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

_Image = NDArray[np.float32]
_Ink = list[float]
_Point = tuple[float, float]

_SHIFT: Final = 4  # fractional bits of OpenCV's coordinates
_UNITS: Final = 24  # of a poster's shorter side
_FONT: Final = cv2.FONT_HERSHEY_DUPLEX
_LETTER_PX: Final = 22.0  # of the font, at scale 1


def poster(columns: int, rows: int, palette: _Image, generator: np.random.Generator) -> _Image:
    """Return a poster; the palette has red, green and blue of each colour, (n, 3), and the first is the paper."""
    paper, inks = palette[0], palette[1:] if len(palette) > 1 else 255 - palette
    canvas = np.empty((rows, columns, 3), np.uint8)
    canvas[:] = paper
    unit = min(columns, rows) / _UNITS
    frame = round(1.2 * unit)
    print_ink: _Ink = (inks[0] if np.abs(inks[0] - paper).sum() > 150 else 255 - paper).tolist()
    _text(canvas, (frame, columns - frame, round(frame + 1.9 * unit)), 1.9 * unit, print_ink, generator)
    top, bottom = round(frame + 2.8 * unit), round(rows - frame - 3.4 * unit)
    _picture(canvas, (frame, top, columns - frame, bottom), inks, generator)
    half = columns // 2
    for left, right in ((frame, half - frame // 2), (half + frame // 2, columns - frame)):
        for line in range(4):
            row = round(bottom + (1.35 + 0.75 * line) * unit)
            _text(canvas, (left, right, row), 0.45 * unit, print_ink, generator)
    cv2.rectangle(canvas, (0, 0), (columns - 1, rows - 1), (paper * 0.55).tolist(), max(1, round(unit * 0.25)))
    return canvas.astype(np.float32)


def _text(
    canvas: NDArray[np.uint8], line: tuple[int, int, int], size: float, ink: _Ink, generator: np.random.Generator
) -> None:
    """Fill a line with imitated words, from left to right."""
    left, right, row = line
    scale, at, thickness = size / _LETTER_PX, float(left), max(1, round(size / 9))
    while True:
        word = "".join(chr(65 + letter) for letter in generator.integers(0, 26, generator.integers(2, 8)))
        (width, _), _ = cv2.getTextSize(word, _FONT, scale, 1)
        if at + width > right:
            return
        cv2.putText(canvas, word, (round(at), row), _FONT, scale, ink, thickness, cv2.LINE_AA)
        at += width + max(size * 0.6, 1.0)


def _picture(
    canvas: NDArray[np.uint8], box: tuple[int, int, int, int], inks: _Image, generator: np.random.Generator
) -> None:
    """Fill a box with squares of two sizes, each with a random shape."""
    left, top, right, bottom = box
    across = max(2, round((right - left) / max((bottom - top) / 4, 1)))
    width, height = (right - left) / across, (bottom - top) / 4
    taken = np.zeros((4, across), dtype=bool)
    for row, column in np.ndindex(taken.shape):
        if taken[row, column]:
            continue
        is_large = generator.random() < 0.3 and row < 3 and column < across - 1 and not taken[row, column + 1]
        size = 2 if is_large else 1
        taken[row : row + size, column : column + size] = True
        first, second = inks[generator.permutation(len(inks))[[0, -1]]]
        pale = (second * 0.5 + canvas[0, 0] * 0.5).tolist()
        place = left + column * width, top + row * height
        cell = Cell(canvas, place, (size * width, size * height), (first.tolist(), second.tolist(), pale), generator)
        _SHAPES[int(generator.integers(len(_SHAPES)))](cell)


@dataclass(frozen=True)
class Cell:
    """A part of a picture, with room for one shape.

    Attributes:
        canvas: all of the poster.
        place: column and row of its upper left corner.
        inks: two for the shape and a pale one for the ground.
        generator: of what is drawn by lot.
    """

    canvas: NDArray[np.uint8]
    place: _Point
    size: tuple[float, float]
    inks: tuple[_Ink, _Ink, _Ink]
    generator: np.random.Generator

    @property
    def radius(self) -> float:
        """Of the largest disc in it."""
        return min(self.size) / 2

    def lot(self, least: float, most: float) -> float:
        """Return a random number."""
        return float(self.generator.uniform(least, most))

    def at(self, across: float, down: float) -> _Point:
        """Return a point, given as shares of the sides."""
        return self.place[0] + across * self.size[0], self.place[1] + down * self.size[1]

    def polygon(self, shares: list[_Point], ink: _Ink) -> None:
        """Draw a convex polygon, its corners given as shares of the sides."""
        corners = np.array([self.at(*share) for share in shares])
        cv2.fillConvexPoly(self.canvas, _fixed(corners), ink, cv2.LINE_AA, _SHIFT)

    def disc(self, middle: _Point, radius: float, ink: _Ink) -> None:
        """Draw a disc around a point of the canvas, clipped to the cell."""
        left, top = round(self.place[0]), round(self.place[1])
        part = self.canvas[top : round(self.place[1] + self.size[1]), left : round(self.place[0] + self.size[0])]
        column, row = _fixed(np.array([middle[0] - left, middle[1] - top])).tolist()
        cv2.circle(part, (column, row), round(radius * (1 << _SHIFT)), ink, -1, cv2.LINE_AA, _SHIFT)


_CORNERS: Final[list[_Point]] = [(0, 0), (1, 0), (1, 1), (0, 1)]


def _target(cell: Cell) -> None:
    cell.polygon(_CORNERS, cell.inks[2])
    cell.disc(cell.at(0.5, 0.5), cell.radius * 0.9, cell.inks[0])
    cell.disc(cell.at(0.5, 0.5), cell.radius * cell.lot(0.2, 0.6), cell.inks[1])


def _triangle(cell: Cell) -> None:
    turn = int(cell.generator.integers(4))
    cell.polygon([_CORNERS[(turn + corner) % 4] for corner in range(3)], cell.inks[0])
    cell.disc(cell.at(0.5, 0.5), cell.radius * cell.lot(0.2, 0.4), cell.inks[1])


def _bars(cell: Cell) -> None:
    for bar in range(5):
        left, top = 0.06 + bar * 0.19, cell.lot(0.0, 0.8)
        cell.polygon([(left, 1), (left, top), (left + 0.13, top), (left + 0.13, 1)], cell.inks[bar % 2])


def _rainbow(cell: Cell) -> None:
    cell.polygon(_CORNERS, cell.inks[2])
    corner = cell.at(*_CORNERS[int(cell.generator.integers(4))])
    for ring in range(4):
        cell.disc(corner, cell.radius * (1.9 - 0.45 * ring), cell.inks[ring % 2])


def _curve(cell: Cell) -> None:
    points = np.array([cell.at(step / 8, cell.lot(0.1, 0.9)) for step in range(9)])
    thickness = max(2, round(cell.radius / 9))
    cv2.polylines(cell.canvas, [_fixed(points)], False, cell.inks[0], thickness, cv2.LINE_AA, _SHIFT)
    for x, y in points[::2].tolist():
        cell.disc((x, y), cell.radius * 0.12, cell.inks[1])


def _dots(cell: Cell) -> None:
    cell.polygon(_CORNERS, cell.inks[2])
    for column, row in np.ndindex(4, 4):
        ink = cell.inks[0 if cell.lot(0, 1) < 0.7 else 1]
        cell.disc(cell.at((column + 0.5) / 4, (row + 0.5) / 4), cell.radius * cell.lot(0.06, 0.22), ink)


_SHAPES: Final[tuple[Callable[[Cell], None], ...]] = (_target, _triangle, _bars, _rainbow, _curve, _dots)


def _fixed(points: NDArray[Any]) -> NDArray[np.int32]:
    return np.asarray(np.rint(points * (1 << _SHIFT)), dtype=np.int32)
