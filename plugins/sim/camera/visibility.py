"""Visibility: culling, and the order in which solids are painted over each other.

Between two convex solids without an overlap there is an upright plane. The solid on the camera's side can hide the
other, but not the reverse. So, seen from one point, convex solids always have an order of depth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from .eye import Eye
from .layers import Layer
from .movers import Mover
from .solids import Block, Drum, Face, Point, Solid, Tower

Seen = tuple[Solid, list[Layer]]
"""A solid and its layers, in painting order."""

_Line = tuple[Point, float, float]
"""A point of a line, and the unit vector across it."""

_NO_LINE: Final = -math.inf
_MOST_REACH_M = 1.0  # radius of a moving object, with its shadow


def far_to_near(eye: Eye, seen: Sequence[Seen]) -> list[Seen]:
    """Return solids in painting order."""
    place = (eye.x_m, eye.y_m)
    spans = [_columns(layers) for _, layers in seen]
    known: set[int] = set()
    ordered: list[Seen] = []
    by_distance = sorted(range(len(seen)), key=lambda number: -math.dist(_middle(seen[number][0]), place))

    def visit(number: int) -> None:
        known.add(number)
        for other in by_distance:
            if (
                other not in known
                and spans[other][0] < spans[number][1]
                and spans[number][0] < spans[other][1]
                and is_nearer(seen[number][0], seen[other][0], place)
            ):
                visit(other)
        ordered.append(seen[number])

    for number in by_distance:
        if number not in known:
            visit(number)
    return ordered


def is_nearer(solid: Solid, other: Solid, place: Point) -> bool:
    """Return whether the first of two solids, seen from a place, may hide the other and cannot be hidden by it."""
    if isinstance(other, Tower):
        return not _is_beyond(_dividing_line(solid, other.drums[0]), place)
    if isinstance(solid, Tower):
        return _is_beyond(_dividing_line(other, solid.drums[0]), place)
    gap_m, line = _widest_gap(solid, other)
    other_gap_m, other_line = _widest_gap(other, solid)
    if gap_m >= other_gap_m:
        return not _is_beyond(line, place)
    return _is_beyond(other_line, place)


def _is_beyond(line: _Line, place: Point) -> bool:
    (x_m, y_m), across_x, across_y = line
    return (place[0] - x_m) * across_x + (place[1] - y_m) * across_y > 0


def _dividing_line(solid: Solid, drum: Drum) -> _Line:
    """Return a line between a solid and a drum, across it towards the drum."""
    x_m, y_m = drum.middle
    if isinstance(solid, Tower):
        nearest, inside = solid.drums[0].middle, False
        reach_m = solid.drums[0].radius_m
    else:
        nearest, inside = _nearest_on(solid, drum.middle)
        reach_m = 0.0
    away_x, away_y = x_m - nearest[0], y_m - nearest[1]
    distance_m = math.hypot(away_x, away_y) or 1.0
    sign = -1.0 if inside else 1.0
    across_x, across_y = sign * away_x / distance_m, sign * away_y / distance_m
    return (nearest[0] + reach_m * across_x, nearest[1] + reach_m * across_y), across_x, across_y


def _nearest_on(block: Block, point: Point) -> tuple[Point, bool]:
    """Return the point of a block's outline that is nearest to a point, and whether the point is inside the block."""
    best, best_m, inside = block.corners[0], math.inf, True
    for (x0, y0), (x1, y1) in zip(block.corners, block.corners[1:] + block.corners[:1], strict=True):
        along_x, along_y = x1 - x0, y1 - y0
        away_x, away_y = point[0] - x0, point[1] - y0
        share = (away_x * along_x + away_y * along_y) / (along_x**2 + along_y**2)
        share = min(max(share, 0.0), 1.0)
        foot = x0 + share * along_x, y0 + share * along_y
        inside &= along_x * away_y - along_y * away_x >= 0
        if (foot_m := math.dist(foot, point)) < best_m:
            best, best_m = foot, foot_m
    return best, inside


def _widest_gap(block: Block, other: Block) -> tuple[float, _Line]:
    """Return the widest gap between an edge of a block and the other block, and that edge, across outwards."""
    widest_m, best = _NO_LINE, (block.corners[0], 0.0, 0.0)
    for (x0, y0), (x1, y1) in zip(block.corners, block.corners[1:] + block.corners[:1], strict=True):
        length_m = math.hypot(x1 - x0, y1 - y0)
        across_x, across_y = (y1 - y0) / length_m, (x0 - x1) / length_m
        gap_m = min((x_m - x0) * across_x + (y_m - y0) * across_y for x_m, y_m in other.corners)
        if gap_m > widest_m:
            widest_m, best = gap_m, ((x0, y0), across_x, across_y)
    return widest_m, best


def _columns(layers: Sequence[Layer]) -> tuple[float, float]:
    """Return the column range of layers: two solids without a common column have no order."""
    left = min(layer.first + 0.5 - layer.left_share for layer in layers)
    return left, max(layer.first + len(layer.tops) - 1.5 + layer.right_share for layer in layers)


def _middle(solid: Solid) -> Point:
    if isinstance(solid, Tower):
        return solid.drums[0].middle
    count = len(solid.corners)
    return sum(x for x, _ in solid.corners) / count, sum(y for _, y in solid.corners) / count


class Faces:
    """Fixed faces.

    Args:
        groups: the faces of each object.
    """

    def __init__(self, groups: Sequence[Sequence[Face]]) -> None:
        faces = [face for group in groups for face in group]
        self._faces = [(number, face) for number, group in enumerate(groups) for face in group]
        self._groups = len(groups)
        self._ends = np.array([[face.left for face in faces], [face.right for face in faces]])
        self._normals = np.array([face.normal for face in faces])
        self._offsets = (self._ends[0] * self._normals).sum(axis=1)

    def in_view(self, eye: Eye) -> list[list[Face]]:
        """Return the faces of each group that face a camera and are in its field of view."""
        slope, right, ahead = eye.lens.width / 2 / eye.focal_px, np.array(eye.right), np.array(eye.ahead)
        place = np.array([eye.x_m, eye.y_m])
        beyond = (self._ends - place) @ np.array([right - slope * ahead, -right - slope * ahead]).T
        shown = (np.minimum(*beyond) < 0).all(axis=1) & (self._normals @ place > self._offsets)
        groups: list[list[Face]] = [[] for _ in range(self._groups)]
        for at in np.flatnonzero(shown).tolist():
            number, face = self._faces[at]
            groups[number].append(face)
        return groups


def may_be_seen(eye: Eye, mover: Mover) -> bool:
    """Return whether a robot or box may be in the image."""
    right_m, ahead_m = eye.seen((mover.x_m, mover.y_m))
    slope = eye.lens.width / 2 / eye.focal_px
    return abs(right_m) - ahead_m * slope < _MOST_REACH_M * math.hypot(1, slope)
