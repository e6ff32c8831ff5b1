"""Splits overlapping blocks, so that no two parts overlap: only then do they have an order of depth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from .solids import Block, Face, Point

_Polygon = tuple[Point, ...]
_THIN_M = 1e-6


def without_overlaps(blocks: Sequence[Block]) -> list[Block]:
    """Return blocks of the same appearance without overlaps: of overlapping parts, the tallest is kept."""
    tallest_first = sorted(blocks, key=lambda block: -block.height_m)
    kept: list[Block] = []
    for number, block in enumerate(tallest_first):
        parts = [block.corners]
        for taller in tallest_first[:number]:
            parts = [piece for part in parts for piece in _outside(part, taller.corners)]
        kept += _parts(block, parts)
    return kept


def cut_out(blocks: Sequence[Block], hole: _Polygon, height_m: float) -> list[Block]:
    """Return blocks without the parts inside a taller solid of a convex outline."""
    kept = []
    for block in blocks:
        parts = [block.corners] if block.height_m > height_m else _outside(block.corners, hole)
        kept += _parts(block, parts)
    return kept


def _outside(polygon: _Polygon, hole: _Polygon) -> list[_Polygon]:
    """Return convex pieces of the part of a convex polygon outside another."""
    pieces, rest = [], polygon
    for start, end in zip(hole, hole[1:] + hole[:1], strict=True):
        piece = _clip(rest, end, start)
        if piece:
            pieces.append(piece)
        rest = _clip(rest, start, end)
        if not rest:
            return [polygon]  # they do not overlap
    return pieces


def _clip(polygon: _Polygon, start: Point, end: Point) -> _Polygon:
    """Return the part of a convex polygon to the left of a line; empty for a sliver."""
    length_m = math.dist(start, end)
    along_x, along_y = (end[0] - start[0]) / length_m, (end[1] - start[1]) / length_m
    sides = [along_x * (y - start[1]) - along_y * (x - start[0]) for x, y in polygon]
    if max(sides) < _THIN_M:
        return ()
    if min(sides) > -_THIN_M:
        return polygon
    kept: list[Point] = []
    for number, (x, y) in enumerate(polygon):
        before, side = sides[number - 1], sides[number]
        if (before < 0) != (side < 0):
            x0, y0 = polygon[number - 1]
            share = before / (before - side)
            kept.append((x0 + share * (x - x0), y0 + share * (y - y0)))
        if side >= 0:
            kept.append((x, y))
    return tuple(point for number, point in enumerate(kept) if math.dist(point, kept[number - 1]) > _THIN_M)


def _parts(block: Block, outlines: Sequence[_Polygon]) -> list[Block]:
    if list(outlines) == [block.corners]:
        return [block]
    parts = []
    for outline in outlines:
        others = [corner for other in outlines if other is not outline for corner in other]
        edges = zip(outline, outline[1:] + outline[:1], strict=True)
        faces = (_face_between(block.faces, start, end, others) for start, end in edges)
        parts.append(replace(block, corners=outline, faces=tuple(face for face in faces if face)))
    return parts


def _face_between(faces: Sequence[Face], left: Point, right: Point, others: Sequence[Point]) -> Face | None:
    """Return the part of a face between two points; None if they are on no face: such a cut is never visible.

    The faces are of the whole block, and continue at `others`, the corners of its other parts.
    """

    def continues(end: Point, whole: Point) -> bool:
        return math.dist(end, whole) > _THIN_M and any(math.dist(end, other) < _THIN_M for other in others)

    for face in faces:
        if _is_on(face, left) and _is_on(face, right):
            offset_m = face.offset_m + math.dist(face.left, left)
            joins = continues(left, face.left) or face.continues[0], continues(right, face.right) or face.continues[1]
            return replace(face, left=left, right=right, offset_m=offset_m, continues=joins)
    return None


def _is_on(face: Face, point: Point) -> bool:
    away_x, away_y = point[0] - face.left[0], point[1] - face.left[1]
    return abs(away_x * face.normal[0] + away_y * face.normal[1]) < _THIN_M
