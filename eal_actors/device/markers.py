"""The families of printed markers that cameras find, by their names in settings."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal, TypeAlias

FamilyName: TypeAlias = Literal["4x4_50", "36h11"]


@dataclass(frozen=True, slots=True)
class MarkerFamily:
    """A family of square markers.

    Attributes:
        dictionary: name of the constant in `cv2.aruco`.
        count: number of markers; their ids are 0 to count - 1.
        cells: squares along a side, with the black border.
    """

    dictionary: str
    count: int
    cells: int


FAMILIES: Final = MappingProxyType[FamilyName, MarkerFamily](
    {"4x4_50": MarkerFamily("DICT_4X4_50", 50, 6), "36h11": MarkerFamily("DICT_APRILTAG_36h11", 587, 8)}
)
"""ArUco 4x4 (50 markers) and AprilTag 36h11 (587 markers)."""
