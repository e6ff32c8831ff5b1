"""Flat surfaces, which are warped into the image by their homographies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache, partial
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from .eye import NEAR_M, Eye, Floats
from .layers import Layer, Rect
from .solids import Block, Face, Plane, Point
from .texture import PAD, Image, Mipmap, halvings

_Line = tuple[float, float, float]
_Matrix = tuple[_Line, _Line, _Line]
_WARP = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
_WHITE = (255, 255, 255, 255)
_STRIP_PX = 32  # OpenCV is slow at narrower strips and other multiples
_COPIED_PX = 1500
_COPIED_BYTES = 1 << 16  # of the texture: smaller ones stay in the processor's cache
_MOST_COPIED = 5
"""A part of the image of at least so many pixels is warped from a copy of the samples that it shows, if these are at
most so many times as many. A copy reads the texture in order, so the processor fetches it ahead; a warp reads it across
and waits for each sample. With the copies, a frame takes a tenth to a quarter less."""
UNDERLAP_PX = 1.0
"""Overlap of a top below its front edge, where a side is painted over it: it prevents gaps."""

_FEW_ROWS = 12  # of the image, drawn with one version of a mipmap
_HORIZON_PX = 0.25  # rows within this distance of the horizon are clamped


def face_layers(eye: Eye, faces: Sequence[Face], *, closed: bool = False) -> list[Layer]:
    """Return the layers of the visible faces of a convex solid, or of a room seen from inside, from left to right.

    If closed, nothing shines through the outer ends either.
    """
    seen = [layer for face in faces if (layer := _face_layer(eye, face))]
    seen.sort(key=lambda layer: (layer.first - layer.left_share, layer.first + len(layer.tops)))
    for number in range(len(seen) if closed else len(seen) - 1):
        seen[number] = seen[number]._replace(right_share=1.0)  # the next one is painted over it
    if closed and seen:
        seen[0] = seen[0]._replace(left_share=1.0)
    return seen


def _face_layer(eye: Eye, face: Face) -> Layer | None:
    normal = face.normal
    distance_m = (eye.x_m - face.left[0]) * normal[0] + (eye.y_m - face.left[1]) * normal[1]
    if distance_m <= 0:
        return None
    ends = _clip(eye.seen(face.left), eye.seen(face.right))
    if ends is None:
        return None
    left, right = (eye.column(*end) for end in ends)
    end = eye.lens.width - 0.5
    if right <= max(left, -0.5) or left >= end:
        return None
    first, last = math.floor(max(left, 0.0) + 0.5), math.floor(min(right, end - 0.5) + 0.5)
    step = _across(eye.right, normal) / eye.focal_px / -distance_m
    start = _across(eye.ahead, normal) / -distance_m - eye.centre_px[0] * step
    least, most = sorted((1 / ends[0][1], 1 / ends[1][1]))
    outer = [min(max(start + step * column, least), most) for column in (first, last)]
    nearness = eye.columns[first : last + 1] * step + start
    nearness[0], nearness[-1] = outer
    lifts_px = [eye.focal_px * (height_m - eye.z_m) for height_m in (face.top_m, face.bottom_m)]
    tops, bottoms = eye.centre_px[1] - np.multiply.outer(np.array(lifts_px, np.float32), nearness)
    rows = [sorted(eye.centre_px[1] - lift_px * inverse for inverse in outer) for lift_px in lifts_px]
    return Layer(
        first,
        tops,
        bottoms,
        (rows[0][0], rows[0][1], rows[1][0], rows[1][1]),
        partial(_fill_face, eye, face, distance_m, outer, step),
        1.0 if face.continues[0] or left < -0.5 else first + 0.5 - left,
        1.0 if face.continues[1] or right > end else min(1.0, right - max(last - 0.5, left)),
    )


def _across(vector: Point, other: Point) -> float:
    return vector[0] * other[0] + vector[1] * other[1]


def _clip(left: Point, right: Point) -> tuple[Point, Point] | None:
    """Return both ends, right and ahead, clipped in front of the camera; None if nothing remains."""
    (x0, z0), (x1, z1) = left, right
    if z0 < NEAR_M and z1 < NEAR_M:
        return None
    if z0 < NEAR_M:
        left = x1 + (x0 - x1) * (z1 - NEAR_M) / (z1 - z0), NEAR_M
    elif z1 < NEAR_M:
        right = x0 + (x1 - x0) * (z0 - NEAR_M) / (z0 - z1), NEAR_M
    return left, right


def _fill_face(
    eye: Eye, face: Face, distance_m: float, outer: Sequence[float], step: float, rect: Rect, target: Image
) -> None:
    """Draw a face, given the inverses of the distances ahead in its outermost columns, and their step."""
    texture, width = face.texture, target.shape[1]
    per_square_m, per_m = texture.per_m[0] / eye.focal_px / distance_m, texture.per_m[1] / eye.focal_px

    def levels(nearness: float) -> tuple[int, int]:
        return texture.level(per_square_m / nearness**2, 0), texture.level(per_m / nearness, 1)

    matrix = face_homography(eye, face, distance_m)
    first, last = map(levels, outer)
    cuts: set[int] = set()
    if first != last:
        changes = [math.sqrt(per_square_m / texture.most(level)) for level in range(*sorted((first[0], last[0])))]
        changes += [per_m / texture.most(level) for level in range(*sorted((first[1], last[1])))]
        cuts.update(round((nearness - outer[0]) / step / _STRIP_PX) * _STRIP_PX for nearness in changes)
    for start, end in pairwise([0, *sorted(cut for cut in cuts if 0 < cut <= width - _STRIP_PX), width]):
        middle = min(max(outer[0] + step * ((start + end) // 2), min(outer)), max(outer))
        part = Rect(rect.left + start, rect.left + end, rect.top, rect.bottom)
        _warp(texture, levels(middle) if cuts else first, matrix, part, target[:, start:end])
    _dim(target, face.gain)


def face_homography(eye: Eye, face: Face, distance_m: float) -> _Matrix:
    """Return the matrix from homogeneous columns and rows to samples of the face's texture, (3, 3)."""
    column, row = eye.centre_px
    focal_px = eye.focal_px
    along_face, normal = face.along, face.normal
    to_eye_m = _across((eye.x_m - face.left[0], eye.y_m - face.left[1]), along_face) + face.offset_m
    scale_step, along_step = _across(eye.right, normal) / focal_px, _across(eye.right, along_face) / focal_px
    scale = _across(eye.ahead, normal) - column * scale_step
    along = _across(eye.ahead, along_face) - column * along_step
    per_x, per_y = face.texture.per_m
    above_m = face.top_m - eye.z_m
    along_row = to_eye_m * scale_step - distance_m * along_step, 0.0, to_eye_m * scale - distance_m * along
    down_row = above_m * scale_step, -distance_m / focal_px, above_m * scale + distance_m * row / focal_px
    return _times(along_row, per_x), _times(down_row, per_y), (scale_step, 0.0, scale)


def plane_homography(eye: Eye, plane: Plane) -> _Matrix:
    """Return the matrix from homogeneous columns and rows to samples of the plane's texture, (3, 3)."""
    column, row = eye.centre_px
    below_m = eye.z_m - plane.height_m
    cos, sin = math.cos(plane.yaw_rad), math.sin(plane.yaw_rad)
    to_eye = eye.x_m - plane.middle[0], eye.y_m - plane.middle[1]

    (right_x, right_y), (ahead_x, ahead_y), far_px = eye.right, eye.ahead, below_m * eye.focal_px

    def line(x: float, y: float, edge_m: float, per_m: float) -> _Line:
        step = below_m * (right_x * x + right_y * y)
        at_m = to_eye[0] * x + to_eye[1] * y + edge_m
        start = far_px * (ahead_x * x + ahead_y * y) - column * step - at_m * row
        return per_m * step, per_m * at_m, per_m * start

    (width_m, height_m), (per_x, per_y) = plane.texture.size_m, plane.texture.per_m
    return line(cos, sin, width_m / 2, per_x), line(sin, -cos, height_m / 2, per_y), (0.0, 1.0, -row)


def _times(line: _Line, factor: float) -> _Line:
    return line[0] * factor, line[1] * factor, line[2] * factor


def fill_plane(eye: Eye, plane: Plane, rect: Rect, target: Image) -> None:
    """Draw a level surface into a part of the image, which must be on its side of the horizon."""
    texture = plane.texture
    below_m = max(abs(eye.z_m - plane.height_m), NEAR_M)
    levels, runs = _levels_of_rows(eye.lens.height, eye.focal_px, below_m, min(texture.per_m), min(texture.deepest))
    matrix = plane_homography(eye, plane)
    if rect.bottom - rect.top <= _FEW_ROWS:
        level = levels[(rect.top + rect.bottom) // 2]
        _warp(texture, (level, level), matrix, rect, target)
    else:
        for start, end in runs:
            top, bottom = max(start, rect.top), min(end, rect.bottom)
            if top < bottom:
                part = Rect(rect.left, rect.right, top, bottom)
                _warp(texture, (levels[top], levels[top]), matrix, part, target[top - rect.top : bottom - rect.top])
    _dim(target, plane.gain)


@lru_cache(maxsize=256)
def _levels_of_rows(
    height: int, focal_px: float, below_m: float, per_m: float, deepest: int
) -> tuple[list[int], list[tuple[int, int]]]:
    """Return the halvings for a level surface in each row of the image, and the runs of equal ones.

    The surface is `below_m` below the camera and has `per_m` samples per metre, which can be halved `deepest` times.
    """
    down_px = np.maximum(np.abs(np.arange(height) - (height - 1) / 2), _HORIZON_PX)
    ahead_m = focal_px * below_m / down_px
    counts = ahead_m**1.5 * (per_m / focal_px / math.sqrt(below_m))  # a compromise: pixels are long and narrow
    levels = halvings(counts, deepest)
    return levels.tolist(), _runs(levels)


def near_plane(eye: Eye, plane: Plane, rect: Rect) -> Image:
    """Return the colours of a level surface with a coarse texture of at most one sample per pixel."""
    colours = np.empty((rect.bottom - rect.top, rect.right - rect.left, 4), np.uint8)
    _warp(plane.texture, (0, 0), plane_homography(eye, plane), rect, colours)
    return colours


def block_layers(eye: Eye, block: Block, faces: Sequence[Face]) -> list[Layer]:
    """Return the layers of a block in painting order, given its visible faces."""
    top = polygon_layer(eye, block.top, block.corners)
    return [*([top] if top else []), *face_layers(eye, faces)]


def polygon_layer(eye: Eye, plane: Plane, corners: Sequence[Point]) -> Layer | None:
    """Return the layer of the part of a level surface below the camera within a convex, counter-clockwise polygon."""
    if eye.z_m <= plane.height_m:
        return None
    seen = [eye.seen(corner) for corner in corners]
    columns = [eye.column(*point) for point in _in_front(seen)]
    if not columns:
        return None
    left, right = max(-0.5, min(columns)), min(eye.lens.width - 0.5, max(columns))
    if left >= right:
        return None
    first, last = math.floor(left + 0.5), min(math.floor(right + 0.5), eye.lens.width - 1)
    entered_m, left_m = _crossed(seen, eye.slopes[first : last + 1])
    tops = eye.rows(plane.height_m, 1 / np.maximum(left_m, entered_m))
    bottoms = eye.rows(plane.height_m, 1 / entered_m) + UNDERLAP_PX * (left_m > entered_m)
    return Layer(
        first,
        tops.astype(np.float32),
        bottoms.astype(np.float32),
        (float(tops.min()), float(tops.max()), float(bottoms.min()), float(bottoms.max())),
        partial(fill_plane, eye, plane),
        left_share=min(1.0, first + 0.5 - left),
        right_share=min(1.0, right - (last - 0.5)),
    )


def _in_front(corners: Sequence[Point]) -> list[Point]:
    """Return the corners of the part of a polygon, right and ahead, in front of the camera."""
    kept = [corner for corner in corners if corner[1] >= NEAR_M]
    for number, (x1, z1) in enumerate(corners):
        x0, z0 = corners[number - 1]
        if (z0 < NEAR_M) != (z1 < NEAR_M):
            kept.append((x0 + (x1 - x0) * (NEAR_M - z0) / (z1 - z0), NEAR_M))
    return kept


def _crossed(corners: Sequence[Point], slopes: Floats) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distances ahead at which each column enters and leaves a counter-clockwise polygon of the plan."""
    x_m, ahead_m = np.array([*corners, corners[0]]).T[..., np.newaxis]
    out_x, out_ahead = ahead_m[1:] - ahead_m[:-1], x_m[:-1] - x_m[1:]  # normals of the edges, outwards
    speeds = slopes * out_x + out_ahead
    with np.errstate(divide="ignore", invalid="ignore"):
        meets_m = (out_x * x_m[:-1] + out_ahead * ahead_m[:-1]) / speeds
    entered = np.where(speeds < 0, meets_m, NEAR_M).max(axis=0)
    left = np.where(speeds > 0, meets_m, np.inf).min(axis=0)
    return np.maximum(entered, NEAR_M), np.maximum(left, NEAR_M)


def _dim(target: Image, gain: float) -> None:
    if gain != 1.0:
        cv2.convertScaleAbs(target, dst=target, alpha=gain)


def _runs(levels: NDArray[np.intp]) -> list[tuple[int, int]]:
    """Return start and end of each run of equal numbers."""
    changes = (np.flatnonzero(np.diff(levels)) + 1).tolist()
    return list(pairwise([0, *changes, len(levels)]))


def _warp(texture: Mipmap, level: tuple[int, int], matrix: _Matrix, part: Rect, target: Image) -> None:
    """Warp a version of a mipmap into a part of the image."""
    image, (left, right, top, bottom) = texture.version(*level), part
    width, height = right - left, bottom - top
    along, down = 0.5 ** level[0], 0.5 ** level[1]  # samples of the version
    (a0, a1, a2), (d0, d1, d2), (s0, s1, s2) = matrix
    a0, a1, a2 = along * a0, along * a1, along * (a2 + a0 * left + a1 * top)  # from the part's corner
    d0, d1, d2 = down * d0, down * d1, down * (d2 + d0 * left + d1 * top)
    s2 += s0 * left + s1 * top
    x_px, y_px = PAD, PAD  # of the first sample
    if width * height >= _COPIED_PX and image.size >= _COPIED_BYTES:
        window = _window(((a0, a1, a2), (d0, d1, d2), (s0, s1, s2)), width, height, image.shape[:2])
        if window is not None:
            image = np.ascontiguousarray(image[window])
            x_px, y_px = PAD - window[1].start, PAD - window[0].start
    shifted = [
        *(a0 + x_px * s0, a1 + x_px * s1, a2 + x_px * s2),
        *(d0 + y_px * s0, d1 + y_px * s1, d2 + y_px * s2),
        *(s0, s1, s2),
    ]
    to_samples = np.array(shifted).reshape(3, 3)
    cv2.warpPerspective(image, to_samples, (width, height), target, _WARP, cv2.BORDER_CONSTANT, _WHITE)


def _window(matrix: _Matrix, width: int, height: int, shape: tuple[int, ...]) -> tuple[slice, slice] | None:
    """Return the rows and columns of a version of a mipmap that a part of the image shows.

    None if they are many, or the part reaches the horizon.
    """
    (a0, a1, a2), (d0, d1, d2), (s0, s1, s2) = matrix
    right, below = width - 1, height - 1
    far = s2, s2 + s0 * right, s2 + s1 * below, s2 + s0 * right + s1 * below  # in the four corners
    if min(far) * max(far) <= 0:
        return None
    x_px = a2 / far[0], (a2 + a0 * right) / far[1], (a2 + a1 * below) / far[2], (a2 + a0 * right + a1 * below) / far[3]
    y_px = d2 / far[0], (d2 + d0 * right) / far[1], (d2 + d1 * below) / far[2], (d2 + d0 * right + d1 * below) / far[3]
    top, bottom = max(math.floor(min(y_px)) + PAD - 1, 0), min(math.ceil(max(y_px)) + PAD + 2, shape[0])
    left, right = max(math.floor(min(x_px)) + PAD - 1, 0), min(math.ceil(max(x_px)) + PAD + 2, shape[1])
    if top >= bottom or left >= right or (bottom - top) * (right - left) > _MOST_COPIED * width * height:
        return None
    return slice(top, bottom), slice(left, right)
