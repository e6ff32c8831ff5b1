"""Finds markers in pictures: in whole pictures, or around expected places, which is several times as fast.

Windows around the expected places are put side by side into one small picture, because every call of OpenCV's detector
has a fixed cost.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.plugin import FAMILIES, FamilyName

from .corners import refine
from .lens import Floats

GAP_PX: Final = 8
"""Between the windows in the small picture: a candidate never reaches from one into another."""
_SMALLEST, _LARGEST = 0.6, 1.6
"""Sides of markers in a window, as shares of the expected length."""


@dataclass(frozen=True)
class Detection:
    """A marker in a picture.

    Attributes:
        corners: in pixels, top left and then clockwise as the print is read, (4, 2).
    """

    number: int
    corners: Floats


@dataclass(frozen=True)
class Found:
    """The result of a search for markers in a picture.

    Attributes:
        mirrored: ids of markers that the picture shows mirrored; None if nobody looked for them.
    """

    detections: list[Detection]
    is_whole: bool
    mirrored: frozenset[int] | None = None

    def to_json(self) -> dict[str, Any]:
        """Return it for JSON, with all bits of the corners."""
        return {
            "markers": [{"id": one.number, "corners": one.corners.tolist()} for one in self.detections],
            "is_whole": self.is_whole,
            "mirrored": None if self.mirrored is None else sorted(self.mirrored),
        }

    @classmethod
    def from_json(cls, found: Mapping[str, Any]) -> Found:
        """Return what `to_json` returned."""
        detections = [Detection(one["id"], np.array(one["corners"], np.float64)) for one in found["markers"]]
        mirrored = found["mirrored"]
        return cls(detections, found["is_whole"], None if mirrored is None else frozenset(mirrored))


@dataclass(frozen=True)
class SearchWindow:
    """A square of the picture in which a marker is expected.

    Attributes:
        column: its centre.
        row: its centre.
        half_px: half its side.
        side_px: expected length of the marker's sides.
    """

    column: float
    row: float
    half_px: float
    side_px: float


class MarkerDetector:
    """Finds the markers of one family, with corners to a fraction of a pixel. Thread: one at a time."""

    def __init__(self, family: FamilyName) -> None:
        self._family = FAMILIES[family]
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self._family.dictionary))
        thorough, quick = cv2.aruco.DetectorParameters(), cv2.aruco.DetectorParameters()
        for parameters in (thorough, quick):
            parameters.minMarkerPerimeterRate = 0.02
            parameters.errorCorrectionRate = 0.5
        quick.adaptiveThreshWinSizeMin = quick.adaptiveThreshWinSizeMax = 13
        self._quick_parameters = quick
        self._thorough = cv2.aruco.ArucoDetector(dictionary, thorough)
        self._quick = cv2.aruco.ArucoDetector(dictionary, quick)

    def find(self, grey: NDArray[np.uint8]) -> list[Detection]:
        """Return the markers in a whole picture, (height, width)."""
        return self._refined(grey, self._detect(self._thorough, grey))

    def find_mirrored(self, grey: NDArray[np.uint8]) -> list[Detection]:
        """Return the markers that a picture shows mirrored; their corners are not refined."""
        last_column = grey.shape[1] - 1
        flipped = np.ascontiguousarray(grey[:, ::-1])
        found = self._detect(self._thorough, flipped)
        return [Detection(one.number, one.corners * (-1, 1) + (last_column, 0)) for one in found]

    def find_around(self, grey: NDArray[np.uint8], windows: Sequence[SearchWindow]) -> list[Detection]:
        """Return the markers inside of windows. One that is in two overlapping windows is returned once."""
        tiles = [_Tile.of(window, grey.shape[:2]) for window in windows]
        tiles = [tile for tile in tiles if tile.side_px > 0]
        if not tiles:
            return []
        mosaic, pitch_px = _mosaic(grey, tiles)
        sides_px = [window.side_px for window in windows]
        self._limit_sides(min(sides_px), max(sides_px), max(mosaic.shape))
        found: list[Detection] = []
        for one in self._refined(mosaic, self._detect(self._quick, mosaic)):
            column, row = (int(part) for part in one.corners.mean(axis=0) // pitch_px)
            number = row * (mosaic.shape[1] // pitch_px) + column
            if number < len(tiles):
                shift = tiles[number].left - column * pitch_px, tiles[number].top - row * pitch_px
                found.append(Detection(one.number, one.corners + shift))
        return _without_repeats(found)

    def _limit_sides(self, least_px: float, most_px: float, picture_px: int) -> None:
        """Ignore squares of other sizes, such as the cells of markers: to decode them takes most of the time."""
        self._quick_parameters.minMarkerPerimeterRate = 4 * _SMALLEST * least_px / picture_px
        self._quick_parameters.maxMarkerPerimeterRate = 4 * _LARGEST * most_px / picture_px
        self._quick.setDetectorParameters(self._quick_parameters)

    @staticmethod
    def _detect(detector: cv2.aruco.ArucoDetector, grey: NDArray[np.uint8]) -> list[Detection]:
        corners, numbers, _ = detector.detectMarkers(grey)
        if numbers is None:
            return []
        return [
            Detection(int(number), np.asarray(one, np.float64).reshape(4, 2))
            for number, one in zip(np.ravel(numbers), corners, strict=True)
        ]

    def _refined(self, grey: NDArray[np.uint8], found: list[Detection]) -> list[Detection]:
        """Return the detections with exact corners."""
        if not found:
            return []
        corners = refine(grey, np.stack([one.corners for one in found]), self._family.cells)
        return [Detection(one.number, exact) for one, exact in zip(found, corners, strict=True)]


@dataclass(frozen=True)
class _Tile:
    """A square part of the picture."""

    left: int
    top: int
    side_px: int

    @classmethod
    def of(cls, window: SearchWindow, shape: tuple[int, int]) -> _Tile:
        side_px = min(2 * math.ceil(window.half_px), *shape)
        left = min(max(round(window.column) - side_px // 2, 0), shape[1] - side_px)
        top = min(max(round(window.row) - side_px // 2, 0), shape[0] - side_px)
        return cls(left, top, side_px)


def _mosaic(grey: NDArray[np.uint8], tiles: Sequence[_Tile]) -> tuple[NDArray[np.uint8], int]:
    """Return a picture of the tiles side by side, and the distance from one to the next."""
    pitch_px = max(tile.side_px for tile in tiles) + GAP_PX
    across = math.ceil(math.sqrt(len(tiles)))
    mosaic = np.full((math.ceil(len(tiles) / across) * pitch_px, across * pitch_px), 128, np.uint8)
    for number, tile in enumerate(tiles):
        x, y = number % across * pitch_px, number // across * pitch_px
        part = grey[tile.top : tile.top + tile.side_px, tile.left : tile.left + tile.side_px]
        mosaic[y : y + tile.side_px, x : x + tile.side_px] = part
    return mosaic, pitch_px


def _without_repeats(found: Iterable[Detection]) -> list[Detection]:
    """Return the detections without those that are in the place of another one of the same id."""
    kept: list[Detection] = []
    for one in found:
        middle, side_px = one.corners.mean(axis=0), float(np.linalg.norm(one.corners[0] - one.corners[1]))
        if not any(
            other.number == one.number and np.linalg.norm(other.corners.mean(axis=0) - middle) < side_px / 2
            for other in kept
        ):
            kept.append(one)
    return kept
