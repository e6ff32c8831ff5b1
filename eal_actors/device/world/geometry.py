"""Overlaps of things on the floor."""

from __future__ import annotations

import math
from itertools import combinations
from typing import Final, TypeAlias

from eal_actors.device.world.model import Beacon, BoxObstacle, CircleObstacle, Drop, FloorPoint, KeepOutZone, MovableBox

Rectangle: TypeAlias = BoxObstacle | MovableBox | Drop
Disc: TypeAlias = CircleObstacle | Beacon

_TOUCHING_M: Final = 1e-6  # things that overlap by less than this merely touch


def corners(rectangle: Rectangle) -> list[tuple[float, float]]:
    """Return x and y of the four corners in metres, in the world's frame, counter-clockwise."""
    cos, sin = _direction(rectangle)
    half_x_m, half_y_m = (size_m / 2 for size_m in rectangle.size_m)
    ends_m = (half_x_m, half_y_m), (-half_x_m, half_y_m), (-half_x_m, -half_y_m), (half_x_m, -half_y_m)
    return [
        (rectangle.x_m + cos * ahead_m - sin * left_m, rectangle.y_m + sin * ahead_m + cos * left_m)
        for ahead_m, left_m in ends_m
    ]


def covers(thing: Rectangle | Disc, x_m: float, y_m: float) -> bool:
    """Return whether a thing covers a point of the floor, its edge included."""
    return _distance_m(thing, x_m, y_m) <= 0.0


def encloses(zone: KeepOutZone, x_m: float, y_m: float) -> bool:
    """Return whether a point is inside a polygon, by the even-odd rule."""
    is_inside = False
    for (x0, y0), (x1, y1) in _edges(zone):
        if (y0 > y_m) != (y1 > y_m) and x_m < x0 + (y_m - y0) * (x1 - x0) / (y1 - y0):
            is_inside = not is_inside
    return is_inside


def crossing_edges(zone: KeepOutZone) -> tuple[int, int] | None:
    """Return the numbers of two edges of a polygon that cross, or None; edge 0 begins at corner 0."""
    for (first, (a, b)), (second, (c, d)) in combinations(enumerate(_edges(zone)), 2):
        if _turn(a, b, c) * _turn(a, b, d) < 0 and _turn(c, d, a) * _turn(c, d, b) < 0:
            return first, second
    return None


def area_m2(zone: KeepOutZone) -> float:
    """Return the area of a polygon whose edges do not cross."""
    return abs(sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in _edges(zone))) / 2


def _edges(zone: KeepOutZone) -> list[tuple[FloorPoint, FloorPoint]]:
    return list(zip(zone, (*zone[1:], zone[0]), strict=True))


def _turn(a: FloorPoint, b: FloorPoint, c: FloorPoint) -> float:
    """Return a number that is positive where a, b and c turn left, and negative where they turn right."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def overlap(rectangle: Rectangle, other: Rectangle | Disc) -> bool:
    """Return whether two things share more than an edge or a corner."""
    if isinstance(other, CircleObstacle | Beacon):
        return _distance_m(rectangle, other.x_m, other.y_m) < other.radius_m - _TOUCHING_M
    reach_m = (math.hypot(*rectangle.size_m) + math.hypot(*other.size_m)) / 2
    if abs(rectangle.x_m - other.x_m) > reach_m or abs(rectangle.y_m - other.y_m) > reach_m:  # most of a thousand boxes
        return False
    # By the separating axes: of two convex shapes that do not overlap, an edge of one has the other wholly beyond it.
    for cos, sin in (_direction(rectangle), _direction(other)):
        for axis_x, axis_y in ((cos, sin), (-sin, cos)):
            ours = [x * axis_x + y * axis_y for x, y in corners(rectangle)]
            theirs = [x * axis_x + y * axis_y for x, y in corners(other)]
            if min(max(ours), max(theirs)) - max(min(ours), min(theirs)) < _TOUCHING_M:
                return False
    return True


def _distance_m(thing: Rectangle | Disc, x_m: float, y_m: float) -> float:
    """Return how far a point lies from a thing; 0 or less within it."""
    east_m, north_m = x_m - thing.x_m, y_m - thing.y_m
    if isinstance(thing, CircleObstacle | Beacon):
        return math.hypot(east_m, north_m) - thing.radius_m
    cos, sin = _direction(thing)
    ahead_m, left_m = cos * east_m + sin * north_m, -sin * east_m + cos * north_m
    beyond_m = (max(0.0, abs(ahead_m) - thing.size_m[0] / 2), max(0.0, abs(left_m) - thing.size_m[1] / 2))
    return math.hypot(*beyond_m)


def _direction(rectangle: Rectangle) -> tuple[float, float]:
    yaw_rad = math.radians(rectangle.yaw_deg)
    return math.cos(yaw_rad), math.sin(yaw_rad)
