"""Prints of markers, and of the ChArUco board for the calibration of cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.device.markers import FAMILIES, FamilyName
from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.markers.sheet import Label, Rectangle, Sheet

_MARGIN_MM: Final = 10.0
_FOOT_MM: Final = 14.0  # for the ruler
_LABEL_MM: Final = 6.0
_MARKER_SHARE: Final = 0.75  # of a square of the board
_BOARD_FAMILY: Final[FamilyName] = "4x4_50"


@dataclass(frozen=True, slots=True)
class BoardSize:
    """A chessboard with markers in its white squares; the columns are along its long side."""

    columns: int = 7
    rows: int = 5
    square_m: float = 0.038

    def __post_init__(self) -> None:
        count = FAMILIES[_BOARD_FAMILY].count
        if not (self.columns >= 3 and self.rows >= 3 and self.columns * self.rows // 2 <= count):
            raise ArgumentError(
                f"a board of {self.columns} x {self.rows} squares: use at least 3 x 3 and at most {2 * count} squares"
            )

    def board(self) -> cv2.aruco.CharucoBoard:
        """Return OpenCV's description of the board."""
        size = self.columns, self.rows
        return cv2.aruco.CharucoBoard(size, self.square_m, self.square_m * _MARKER_SHARE, dictionary(_BOARD_FAMILY))


def dictionary(family: FamilyName) -> cv2.aruco.Dictionary:
    """Return OpenCV's dictionary of a family."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, FAMILIES[family].dictionary))


def marker_sheets(ids: Sequence[int], family: FamilyName, size_mm: float, paper_mm: tuple[float, float]) -> list[Sheet]:
    """Return sheets with markers, each with its white border, its number, and an arrow to its right edge.

    `size_mm` is the side of the black square. Raises ArgumentError if the family has no such marker, or a marker does
    not fit on the paper.
    """
    kind = FAMILIES[family]
    if not ids or (beyond := [number for number in ids if not 0 <= number < kind.count]):
        named = ", ".join(map(str, beyond)) if ids else "none"
        raise ArgumentError(f"markers {named}: the family {family} has the markers 0 to {kind.count - 1}")
    plate_mm = size_mm * (kind.cells + 2) / kind.cells
    width_mm, height_mm = paper_mm
    across = int((width_mm - 2 * _MARGIN_MM) // plate_mm)
    down = int((height_mm - _MARGIN_MM - _FOOT_MM) // (plate_mm + _LABEL_MM))
    if not across or not down:
        raise ArgumentError(
            f"a marker of {size_mm:g} mm with its border of {size_mm / kind.cells:.0f} mm does not fit on paper of "
            f"{width_mm:g} x {height_mm:g} mm: choose a larger paper"
        )
    sheets: list[Sheet] = []
    for place, number in enumerate(ids):
        if place % (across * down) == 0:
            sheets.append(Sheet(width_mm, height_mm))
            sheets[-1].add_ruler()
        column, row = place % across, place % (across * down) // across
        x_mm, y_mm = _MARGIN_MM + column * plate_mm, _MARGIN_MM + row * (plate_mm + _LABEL_MM)
        cells = cv2.aruco.generateImageMarker(dictionary(family), number, kind.cells)
        cell_mm = size_mm / kind.cells
        sheets[-1].rectangles += _dark_runs(np.asarray(cells), x_mm + cell_mm, y_mm + cell_mm, cell_mm)
        text = f"{family}  id {number}  {size_mm:g} mm  front: this way >"
        sheets[-1].labels.append(Label(x_mm + cell_mm, y_mm + plate_mm + 2.5, text))
    return sheets


def board_sheet(size: BoardSize, paper_mm: tuple[float, float]) -> Sheet:
    """Return a sheet, in landscape, with the board; raise ArgumentError if it does not fit on the paper."""
    width_mm, height_mm = max(paper_mm), min(paper_mm)
    square_mm = size.square_m * 1000
    left_mm = (width_mm - size.columns * square_mm) / 2
    if left_mm < 0 or size.rows * square_mm > height_mm - _FOOT_MM:
        raise ArgumentError(
            f"a board of {size.columns} x {size.rows} squares of {square_mm:g} mm does not fit on paper of "
            f"{width_mm:g} x {height_mm:g} mm: choose a larger paper, or fewer or smaller squares"
        )
    sheet = Sheet(width_mm, height_mm)
    top_mm = (height_mm - _FOOT_MM - size.rows * square_mm) / 2
    sheet.rectangles += [
        Rectangle(left_mm + column * square_mm, top_mm + row * square_mm, square_mm, square_mm)
        for row in range(size.rows)
        for column in range(size.columns)
        if (row + column) % 2 == 0
    ]
    board, cells = size.board(), FAMILIES[_BOARD_FAMILY].cells
    cell_mm = square_mm * _MARKER_SHARE / cells
    for number, corners in zip(np.ravel(board.getIds()).tolist(), board.getObjPoints(), strict=True):
        corner_m: Any = np.asarray(corners)[0]
        image = cv2.aruco.generateImageMarker(dictionary(_BOARD_FAMILY), number, cells)
        x_mm, y_mm = left_mm + float(corner_m[0]) * 1000, top_mm + float(corner_m[1]) * 1000
        sheet.rectangles += _dark_runs(np.asarray(image), x_mm, y_mm, cell_mm)
    sheet.add_ruler()
    name = f"ChArUco board, {size.columns} x {size.rows} squares of {square_mm:g} mm"
    sheet.labels.append(Label(10.0, height_mm - 10.5, name))
    return sheet


def _dark_runs(cells: NDArray[Any], x_mm: float, y_mm: float, cell_mm: float) -> list[Rectangle]:
    """Return a rectangle for each run of dark cells in a row."""
    found = []
    for row, line in enumerate(cells < 128):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], line.astype(int), [0]])))
        found += [
            Rectangle(x_mm + start * cell_mm, y_mm + row * cell_mm, (end - start) * cell_mm, cell_mm)
            for start, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
        ]
    return found
