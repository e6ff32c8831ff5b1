"""The lens of a camera, from pictures of a ChArUco board."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.markers.prints import BoardSize

LEAST_PICTURES: Final = 8
LEAST_CORNERS: Final = 8
GOOD_ERROR_PX: Final = 1.0
GOOD_COVERAGE: Final = 0.6
_GRID: Final = 8  # cells along each side, for the coverage


@dataclass(frozen=True, slots=True)
class BoardView:
    """The corners of a board, in metres on it, (n, 3), and in a picture, (n, 2)."""

    points: NDArray[np.float32]
    pixels: NDArray[np.float32]
    size_px: tuple[int, int]


@dataclass(frozen=True, slots=True)
class LensFit:
    """A calibrated lens.

    Attributes:
        focal_px: focal lengths along the columns and the rows.
        centre_px: column and row of the axis.
        distortion: k1, k2, p1, p2, k3.
        error_px: root mean square distance of the corners from where the lens puts them.
        coverage: share of the picture in which there were corners.
    """

    size_px: tuple[int, int]
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, ...]
    error_px: float
    focal_sd_px: float
    coverage: float

    def as_yaml(self) -> str:
        """Return the setting `lens` of the plugin `tracker`."""
        return (
            "lens:\n"
            f"  size_px: [{self.size_px[0]}, {self.size_px[1]}]\n"
            f"  focal_px: [{self.focal_px[0]:.2f}, {self.focal_px[1]:.2f}]\n"
            f"  centre_px: [{self.centre_px[0]:.2f}, {self.centre_px[1]:.2f}]\n"
            f"  distortion: [{', '.join(f'{part:.6f}' for part in self.distortion)}]\n"
        )


class BoardFinder:
    """Finds a board in pictures. Thread: one at a time."""

    def __init__(self, size: BoardSize) -> None:
        self._board: Any = size.board()  # OpenCV's annotations ask for a list of corners, which it refuses
        self._detector = cv2.aruco.CharucoDetector(self._board)

    def find(self, picture: NDArray[np.uint8]) -> BoardView | None:
        """Return the board in a picture, grey or in colour; None if fewer than 8 of its corners are visible."""
        grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        corners, numbers, _, _ = self._detector.detectBoard(grey)
        if numbers is None or len(numbers) < LEAST_CORNERS:  # type: ignore[redundant-expr]  # the annotation omits None
            return None
        points, pixels = self._board.matchImagePoints(corners, numbers)
        height, width = grey.shape[:2]
        return BoardView(
            np.asarray(points, np.float32).reshape(-1, 3),
            np.asarray(pixels, np.float32).reshape(-1, 2),
            (width, height),
        )


def is_new_view(view: BoardView, others: list[BoardView]) -> bool:
    """Return whether a board is somewhere else than in the other pictures, by 6 % of the picture's width."""
    place = _place(view)
    return all(float(np.abs(place - _place(other)).max()) > 0.06 * view.size_px[0] for other in others)


def _place(view: BoardView) -> NDArray[np.float64]:
    """Return the extent of the seen corners, (4,), in pixels."""
    return np.concatenate([view.pixels.min(axis=0), view.pixels.max(axis=0)]).astype(np.float64)


def fit_lens(views: list[BoardView]) -> LensFit:
    """Fit a lens to pictures of a board; raise ArgumentError if there are too few pictures, or their sizes differ."""
    if len(views) < LEAST_PICTURES:
        raise ArgumentError(f"the board is in {len(views)} pictures; at least {LEAST_PICTURES} are needed, better 20")
    sizes = {view.size_px for view in views}
    if len(sizes) > 1:
        named = ", ".join(f"{width} x {height}" for width, height in sorted(sizes))
        raise ArgumentError(f"pictures of different sizes: {named} px")
    (size_px,) = sizes
    points, pixels = [view.points for view in views], [view.pixels for view in views]
    found = cv2.calibrateCameraExtended(points, pixels, size_px, None, None)  # type: ignore[call-overload]
    error_px, matrix, distortion, deviations = found[0], found[1], found[2], found[5]
    fx, fy, cx, cy = (float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return LensFit(
        size_px=size_px,
        focal_px=(fx, fy),
        centre_px=(cx, cy),
        distortion=tuple(float(part) for part in np.ravel(distortion)[:5]),
        error_px=float(error_px),
        focal_sd_px=float(np.ravel(deviations)[:2].max()),
        coverage=_coverage(np.concatenate(pixels), size_px),
    )


def _coverage(pixels: NDArray[np.float32], size_px: tuple[int, int]) -> float:
    """Return the share of the cells of a grid that have a corner."""
    cells = np.clip((pixels / np.array(size_px) * _GRID).astype(int), 0, _GRID - 1)
    return len(np.unique(cells[:, 0] * _GRID + cells[:, 1])) / _GRID**2
