"""Fence: a polygon that motions must not leave; pure geometry."""

from __future__ import annotations

import math
from collections.abc import Sequence

Point = tuple[float, float]


class Fence:
    """A polygon.

    Args:
        corners: in order, in m.

    Raises:
        ValueError: there are fewer than three corners, or one is not finite.
    """

    def __init__(self, corners: Sequence[Point]) -> None:
        if len(corners) < 3 or not all(math.isfinite(number) for corner in corners for number in corner):
            raise ValueError("a geofence has at least three corners of finite numbers")
        self._sides = [(corners[number - 1], corner) for number, corner in enumerate(corners)]

    def contains(self, point: Point) -> bool:
        """Return whether a point is inside."""
        x_m, y_m = point
        crossings = 0
        for (ax, ay), (bx, by) in self._sides:
            if (ay > y_m) != (by > y_m) and x_m < ax + (y_m - ay) / (by - ay) * (bx - ax):
                crossings += 1
        return crossings % 2 == 1

    def contains_way(self, start: Point, end: Point) -> bool:
        """Return whether a straight way stays inside. A start outside may lead inside."""
        if not self.contains(end):
            return False
        return not self.contains(start) or not any(_cross(start, end, a, b) for a, b in self._sides)


def _cross(a: Point, b: Point, c: Point, d: Point) -> bool:
    """Return whether two segments cross."""
    return _side(a, b, c) * _side(a, b, d) < 0 and _side(c, d, a) * _side(c, d, b) < 0


def _side(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
