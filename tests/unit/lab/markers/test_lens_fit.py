"""The lens of a camera from pictures of a board that OpenCV draws and distorts."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.markers.lens_fit import BoardFinder, fit_lens, is_new_view
from eal_actors.lab.markers.prints import BoardSize
from tests.unit.lab.markers.board_pictures import DISTORTION, MATRIX, SIZE, board_picture


def test_the_true_lens_is_found() -> None:
    board = BoardSize()
    finder = BoardFinder(board)
    views = [view for seed in range(12) if (view := finder.find(board_picture(board, seed))) is not None]
    assert len(views) >= 10
    fit = fit_lens(views)
    assert fit.error_px < 0.3
    assert fit.size_px == SIZE
    found = np.array([[fit.focal_px[0], 0, fit.centre_px[0]], [0, fit.focal_px[1], fit.centre_px[1]], [0, 0, 1]])
    columns, rows = np.meshgrid(np.linspace(-0.5, 0.5, 7), np.linspace(-0.38, 0.38, 7))
    points = np.stack([columns, rows, np.ones_like(columns)], axis=-1).reshape(-1, 1, 3)
    still = np.zeros(3)
    true, _ = cv2.projectPoints(points, still, still, MATRIX, DISTORTION)
    ours, _ = cv2.projectPoints(points, still, still, found, np.array(fit.distortion))
    away = (ours - true).reshape(-1, 2)
    assert np.abs(away - away.mean(axis=0)).max() < 1.5, f"pixels from the true lens: {np.abs(away).max():.2f}"
    assert fit.focal_px == pytest.approx((512, 512), rel=0.005)


def test_too_few_pictures_are_refused() -> None:
    board = BoardSize()
    view = BoardFinder(board).find(board_picture(board, 1))
    assert view is not None
    assert not is_new_view(view, [view])
    with pytest.raises(ArgumentError, match="the board is in 3 pictures; at least 8 are needed, better 20"):
        fit_lens([view] * 3)


def test_a_picture_without_a_board_has_no_view() -> None:
    assert BoardFinder(BoardSize()).find(np.full((480, 640), 200, np.uint8)) is None
