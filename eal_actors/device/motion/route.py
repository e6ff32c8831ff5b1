"""A polyline in the map frame, and how far a robot has come along it."""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Sequence
from typing import Final

from eal_actors.device.localization.pose_estimate import Point

_CORNER_RAD: Final = math.radians(30)
"""A sharper bend is a corner: the robot drives to it and turns in place, so that it never cuts it."""
_JITTER_M: Final = 0.01
"""The points of a leg are so near to its line: recorded points stray, and those of a grid form stairs."""
_LEG_M: Final = 0.06  # longest leg of several points
_SAME_M: Final = 1e-4  # points that are nearer to the former one are left out, but for the last
_WINDOW_M: Final = 0.3
"""The robot is searched so far along the route, so that a route that crosses itself is driven in order."""


class Route:
    """A polyline, driven from its first point to its last.

    `points` are x and y in metres; the first is the robot's own place. `travelled_m` is how far along it the robot has
    come; it never falls.
    """

    def __init__(self, points: Sequence[Point]) -> None:
        self._points = [points[0]]
        for point in points[1:]:
            if math.dist(self._points[-1], point) > _SAME_M:
                self._points.append(point)
        if len(self._points) > 1:
            self._points[-1] = points[-1]
        ways_m = [math.dist(here, there) for here, there in itertools.pairwise(self._points)]
        self._starts_m = [0.0, *itertools.accumulate(ways_m)]
        ends = _ends_of_legs(self._points)
        legs = list(itertools.pairwise(ends)) or [(0, 0)]
        self._corners = [leg for leg, (_, after) in itertools.pairwise(legs) if self._is_corner(*leg, after)]
        self._corners.append(legs[-1])  # each with where its last leg begins
        self._passed = 0
        self.length_m = self._starts_m[-1]
        self.travelled_m = 0.0

    def _is_corner(self, before: int, place: int, after: int) -> bool:
        (ax, ay), (bx, by), (cx, cy) = (self._points[number] for number in (before, place, after))
        bend_rad = math.atan2(cy - by, cx - bx) - math.atan2(by - ay, bx - ax)
        return abs(math.remainder(bend_rad, math.tau)) > _CORNER_RAD

    @property
    def end(self) -> Point:
        """The last point."""
        return self._points[-1]

    @property
    def corner_m(self) -> float:
        """The distance along the route of the next corner, which the end is too."""
        return self._starts_m[self._corners[self._passed][1]]

    def advance(self, x_m: float, y_m: float) -> None:
        """Update `travelled_m` from the robot's place, at most to the next corner."""
        until_m = min(self.travelled_m + _WINDOW_M, self.corner_m)
        nearest_m, least_m = self.travelled_m, math.inf
        for place in range(self._place_of(self.travelled_m), len(self._starts_m) - 1):
            if self._starts_m[place] > until_m:
                break
            along_m = min(max(self._project(place, x_m, y_m), self.travelled_m), until_m)
            off_m = math.dist((x_m, y_m), self.point_at(along_m))
            if off_m < least_m:
                nearest_m, least_m = along_m, off_m
        self.travelled_m = nearest_m

    def pass_corner(self) -> None:
        """Count the next corner as reached."""
        self.travelled_m = self.corner_m
        self._passed = min(self._passed + 1, len(self._corners) - 1)

    def point_at(self, along_m: float) -> Point:
        """Return the point at a distance along the route, from 0 to its length."""
        place = self._place_of(along_m)
        (ax, ay), (bx, by) = self._points[place], self._points[min(place + 1, len(self._points) - 1)]
        way_m = math.dist((ax, ay), (bx, by))
        share = min((along_m - self._starts_m[place]) / way_m, 1.0) if way_m else 0.0
        return ax + share * (bx - ax), ay + share * (by - ay)

    def point_ahead(self, along_m: float) -> Point:
        """Return the same; beyond the next corner, the point straight on."""
        over_m = along_m - self.corner_m
        if over_m <= 0:
            return self.point_at(along_m)
        before, place = self._corners[self._passed]
        (ax, ay), (bx, by) = self._points[before], self._points[place]
        share = over_m / (self._starts_m[place] - self._starts_m[before])
        return bx + share * (bx - ax), by + share * (by - ay)

    def _place_of(self, along_m: float) -> int:
        return min(max(bisect.bisect_right(self._starts_m, along_m) - 1, 0), max(len(self._points) - 2, 0))

    def _project(self, place: int, x_m: float, y_m: float) -> float:
        """Return the distance along the route of the point of a segment's line that is nearest to a place."""
        (ax, ay), (bx, by) = self._points[place], self._points[place + 1]
        ux, uy, way_m = bx - ax, by - ay, self._starts_m[place + 1] - self._starts_m[place]
        share = ((x_m - ax) * ux + (y_m - ay) * uy) / (way_m * way_m)
        return self._starts_m[place] + min(max(share, 0.0), 1.0) * way_m


class _Leg:
    """A straight part of a route."""

    def __init__(self, start: Point) -> None:
        self._start = start
        self._course_rad: float | None = None
        self._least_rad = self._most_rad = 0.0  # of the courses, from the first one, that are near to all points
        self._reach_m = 0.0

    def takes(self, point: Point) -> bool:
        """Add a point, unless the leg would bend, turn back or be too long; return whether it was added."""
        way_m = math.dist(self._start, point)
        if way_m <= _JITTER_M:
            return self._reach_m <= 2 * _JITTER_M
        course_rad, half_rad = self._course_to(point), math.asin(_JITTER_M / way_m)
        if self._course_rad is None:
            self._course_rad, self._least_rad, self._most_rad = course_rad, -half_rad, half_rad
        else:
            turn_rad = math.remainder(course_rad - self._course_rad, math.tau)
            if not (self._least_rad <= turn_rad <= self._most_rad and self._reach_m - _JITTER_M <= way_m <= _LEG_M):
                return False
            self._least_rad = max(self._least_rad, turn_rad - half_rad)
            self._most_rad = min(self._most_rad, turn_rad + half_rad)
        self._reach_m = max(self._reach_m, way_m)
        return True

    def _course_to(self, point: Point) -> float:
        return math.atan2(point[1] - self._start[1], point[0] - self._start[0])


def _ends_of_legs(points: Sequence[Point]) -> list[int]:
    """Return the numbers of the points at which legs begin or end.

    Source: J. Sklansky and V. Gonzalez, "Fast polygonal approximation of digitized curves", 1980.
    """
    ends, leg = [0], _Leg(points[0])
    for number in range(1, len(points)):
        if not leg.takes(points[number]):
            ends.append(number - 1)
            leg = _Leg(points[number - 1])
            leg.takes(points[number])
    return [*ends, len(points) - 1] if len(points) > 1 else ends
