"""Prints of markers and boards: OpenCV finds them in the rendered sheets, at the right scale."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.markers.prints import BoardSize, board_sheet, marker_sheets
from eal_actors.lab.markers.sheet import PAPERS_MM, as_pdf, as_svg
from tests.unit.lab.markers.board_pictures import PER_MM, pdf_pixels, svg_pixels

DICTIONARIES: dict[Any, int] = {"4x4_50": cv2.aruco.DICT_4X4_50, "36h11": cv2.aruco.DICT_APRILTAG_36h11}


@pytest.mark.parametrize("family", ["4x4_50", "36h11"])
def test_opencv_finds_the_printed_markers_at_their_size(family: Any) -> None:
    sheets = marker_sheets([3, 0, 7, 12, 5, 9, 30], family, 50.0, PAPERS_MM["a4"])
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(DICTIONARIES[family]))
    found: list[int] = []
    for page, sheet in enumerate(sheets):
        svg, pdf = svg_pixels(as_svg(sheet)), pdf_pixels(as_pdf(sheets), page)
        assert np.mean(svg != pdf) < 0.002, "both formats show the same"
        corners, numbers, _ = detector.detectMarkers(pdf)
        for number, one in zip(np.ravel(numbers), corners, strict=True):
            square = np.asarray(one).reshape(4, 2)
            sides_mm = np.linalg.norm(square - np.roll(square, 1, axis=0), axis=1) / PER_MM
            assert np.allclose(sides_mm, 50, atol=0.4)
            assert square[1][0] > square[0][0], "the print stands upright: its right edge is on the right"
            found.append(int(number))
    assert sorted(found) == [0, 3, 5, 7, 9, 12, 30]


def test_the_board_is_that_of_opencv() -> None:
    size = BoardSize()
    sheet = board_sheet(size, PAPERS_MM["a4"])
    pixels = svg_pixels(as_svg(sheet))
    width, height = (
        round(size.columns * size.square_m * 1000 * PER_MM),
        round(size.rows * size.square_m * 1000 * PER_MM),
    )
    left, top = (pixels.shape[1] - width) // 2, round((210 - 14 - size.rows * 38) / 2 * PER_MM)
    ours = pixels[top : top + height, left : left + width]
    theirs = size.board().generateImage((width, height))
    assert np.mean(np.abs(ours.astype(int) - theirs.astype(int)) > 128) < 0.005
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(size.board()).detectBoard(pixels)
    assert len(numbers) == (size.columns - 1) * (size.rows - 1)
    assert np.ptp(np.asarray(corners).reshape(-1, 2)[:, 0]) / PER_MM == pytest.approx(5 * 38, abs=0.2)


def test_a_ruler_of_100_mm_shows_the_scale() -> None:
    (sheet,) = marker_sheets([1], "4x4_50", 120.0, PAPERS_MM["letter"])
    assert max(one.width_mm for one in sheet.rectangles if one.height_mm < 1) == 100.0
    assert any("100 mm" in label.text for label in sheet.labels)


@pytest.mark.parametrize(
    ("ids", "size_mm", "problem"),
    [
        ([50], 100.0, "markers 50: the family 4x4_50 has the markers 0 to 49"),
        ([], 100.0, "markers none"),
        ([1], 200.0, "does not fit on paper of 210 x 297 mm"),
    ],
)
def test_markers_that_cannot_be_printed_are_refused(ids: list[int], size_mm: float, problem: str) -> None:
    with pytest.raises(ArgumentError, match=problem):
        marker_sheets(ids, "4x4_50", size_mm, PAPERS_MM["a4"])


def test_boards_that_cannot_be_printed_are_refused() -> None:
    with pytest.raises(ArgumentError, match="does not fit on paper"):
        board_sheet(BoardSize(9, 6), PAPERS_MM["a4"])
    with pytest.raises(ArgumentError, match="use at least 3 x 3 and at most 100 squares"):
        BoardSize(11, 10)
