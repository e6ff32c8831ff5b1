"""Flat surfaces, which are warped into the image by their homographies."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache, partial

import cv2
import numpy as np
from numpy.typing import NDArray

from .eye import NEAR_M, Eye, Floats, PinholeLens
from .layers import Layer, Rect
from .solids import Block, Face, Plane, Point
from .texture import PAD, Image, Mipmap, halvings

_Line = tuple[float, float, float]
_Matrix = tuple[_Line, _Line, _Line]
_WARP = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
_WHITE = (255, 255, 255, 255)
_STRIP_PX = 16  # OpenCV is slow at narrower strips and other multiples
_COPIED_PX = 4000
_MOST_COPIED = 5
"""A part of the image of at least so many pixels is warped from a copy of the samples that it shows, if these are at
most so many times as many. A copy reads the texture in order, so the processor fetches it ahead; a warp reads it across
and waits for each sample. With the copies, a frame takes a tenth to a quarter less."""
UNDERLAP_PX = 1.0
"""Overlap of a top below its front edge, where a side is painted over it: it prevents gaps."""

_FEW_ROWS = 12  # of the image, drawn with one version of a mipmap
_HORIZON_PX = 0.25  # rows within this distance of the horizon are clamped


def face_layers(eye: Eye, faces: Sequence[Face], *, closed: bool = False) -> list[Layer]:
    """Return the layers of the visible faces, from left to right.

    Args:
        eye: the camera.
        faces: of one convex solid, or the walls of a room seen from inside.
        closed: whether nothing is to shine through the outer ends either.
    """
    seen = [layer for face in faces if (layer := _face_layer(eye, face))]
    seen.sort(key=lambda layer: (layer.first - layer.left_share, layer.columns.stop))
    for layer in seen if closed else seen[:-1]:
        layer.right_share = 1.0  # the next one is painted over it
    if closed:
        for layer in seen[:1]:
            layer.left_share = 1.0
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
    nearness = start + step * eye.columns[first : last + 1]
    least, most = sorted((1 / ends[0][1], 1 / ends[1][1]))
    nearness[0] = min(max(start + step * first, least), most)
    nearness[-1] = min(max(start + step * last, least), most)
    return Layer(
        first,
        eye.rows(face.top_m, nearness),
        eye.rows(face.bottom_m, nearness),
        partial(_fill_face, eye, face, distance_m, nearness),
        left_share=1.0 if face.continues[0] or left < -0.5 else first + 0.5 - left,
        right_share=1.0 if face.continues[1] or right > end else min(1.0, right - max(last - 0.5, left)),
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


def _fill_face(eye: Eye, face: Face, distance_m: float, nearness: Floats, rect: Rect, target: Image) -> None:
    texture, per_px = face.texture, 1 / eye.focal_px

    def levels(ahead_m: float) -> tuple[int, int]:
        along = texture.level(ahead_m**2 / distance_m * per_px * texture.per_m[0], 0)
        return along, texture.level(ahead_m * per_px * texture.per_m[1], 1)

    matrix = face_homography(eye, face, distance_m)
    everywhere = levels(1 / float(nearness[0]))
    if everywhere == levels(1 / float(nearness[-1])):
        _warp(texture, everywhere, matrix, rect, target)
    else:
        ahead_m = 1 / nearness
        along = texture.levels(ahead_m**2 / distance_m * per_px * texture.per_m[0], 0)
        across = texture.levels(ahead_m * per_px * texture.per_m[1], 1)
        for start, end in _runs(along * 64 + across, _STRIP_PX):
            middle = (start + end) // 2
            if end == len(along):
                end = target.shape[1]
            part = Rect(rect.left + start, rect.left + end, rect.top, rect.bottom)
            _warp(texture, (int(along[middle]), int(across[middle])), matrix, part, target[:, start:end])
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
    levels, runs = _levels_of_rows(eye.lens, below_m, min(texture.per_m), min(texture.deepest))
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
    lens: PinholeLens, below_m: float, per_m: float, deepest: int
) -> tuple[list[int], list[tuple[int, int]]]:
    """Return the halvings for a level surface in each row of the image, and the runs of equal ones.

    Args:
        lens: of the camera.
        below_m: vertical distance of camera and surface.
        per_m: samples per metre.
        deepest: the number of possible halvings.
    """
    down_px = np.maximum(np.abs(np.arange(lens.height) - lens.centre_px[1]), _HORIZON_PX)
    ahead_m = lens.focal_px * below_m / down_px
    counts = ahead_m**1.5 * (per_m / lens.focal_px / math.sqrt(below_m))  # a compromise: pixels are long and narrow
    levels = halvings(counts, deepest)
    return levels.tolist(), list(_runs(levels))


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
    """Return the layer of the part of a level surface below the camera that a convex polygon bounds.

    Args:
        eye: the camera.
        plane: the surface.
        corners: counter-clockwise, x and y in metres.
    """
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
    entered_m, left_m = _crossed(np.array(seen), eye.slopes[first : last + 1])
    return Layer(
        first,
        eye.rows(plane.height_m, 1 / np.maximum(left_m, entered_m)),
        eye.rows(plane.height_m, 1 / entered_m) + UNDERLAP_PX * (left_m > entered_m),
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


def _crossed(
    corners: NDArray[np.float64], slopes: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distances ahead at which each column enters and leaves a counter-clockwise polygon of the plan."""
    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1)  # outwards, with x to the right and y ahead
    offsets = (normals * corners).sum(axis=1)
    speeds = slopes[:, np.newaxis] * normals[:, 0] + normals[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        meets_m = offsets / speeds
    entered = np.where(speeds < 0, meets_m, NEAR_M).max(axis=1)
    left = np.where(speeds > 0, meets_m, np.inf).min(axis=1)
    return np.maximum(entered, NEAR_M), np.maximum(left, NEAR_M)


def _dim(target: Image, gain: float) -> None:
    if gain != 1.0:
        cv2.convertScaleAbs(target, dst=target, alpha=gain)


def _runs(levels: NDArray[np.intp], least: int = 1) -> Iterator[tuple[int, int]]:
    """Yield start and end of each run of equal or similar numbers, in multiples of `least`."""
    start, size = 0, len(levels)
    for change in (np.flatnonzero(np.diff(levels)) + 1).tolist():
        end = round(change / least) * least
        if start < end <= size - least:
            yield start, end
            start = end
    yield start, size


def _warp(texture: Mipmap, level: tuple[int, int], matrix: _Matrix, part: Rect, target: Image) -> None:
    """Warp a version of a mipmap into a part of the image."""
    (a0, a1, a2), (d0, d1, d2), (s0, s1, s2) = matrix
    along, down = 0.5 ** level[0], 0.5 ** level[1]  # samples of the version
    image, columns, rows = texture.version(*level), part.right - part.left, part.bottom - part.top
    x_px, y_px = PAD, PAD  # of the first sample
    if columns * rows >= _COPIED_PX:
        lines = _times(matrix[0], along), _times(matrix[1], down), matrix[2]
        window = _window(lines, part, image.shape[:2])
        if window is not None:
            image = np.ascontiguousarray(image[window])
            x_px, y_px = PAD - window[1].start, PAD - window[0].start
    a2, d2, s2 = (edge + step * part.left + fall * part.top for step, fall, edge in matrix)  # from the part's corner
    shifted = [
        *(along * a0 + x_px * s0, along * a1 + x_px * s1, along * a2 + x_px * s2),
        *(down * d0 + y_px * s0, down * d1 + y_px * s1, down * d2 + y_px * s2),
        *(s0, s1, s2),
    ]
    to_samples = np.array(shifted).reshape(3, 3)
    cv2.warpPerspective(image, to_samples, (columns, rows), target, _WARP, cv2.BORDER_CONSTANT, _WHITE)


def _window(matrix: _Matrix, part: Rect, shape: tuple[int, ...]) -> tuple[slice, slice] | None:
    """Return the rows and columns of a version of a mipmap that a part of the image shows.

    None if they are many, or the part reaches the horizon.
    """
    across, down, scale = matrix
    x_px, y_px = [], []
    for column in (part.left, part.right - 1):
        for row in (part.top, part.bottom - 1):
            far = scale[0] * column + scale[1] * row + scale[2]
            if far * (scale[0] * part.left + scale[1] * part.top + scale[2]) <= 0:
                return None
            x_px.append((across[0] * column + across[1] * row + across[2]) / far)
            y_px.append((down[0] * column + down[1] * row + down[2]) / far)
    top, bottom = max(math.floor(min(y_px)) + PAD - 1, 0), min(math.ceil(max(y_px)) + PAD + 2, shape[0])
    left, right = max(math.floor(min(x_px)) + PAD - 1, 0), min(math.ceil(max(x_px)) + PAD + 2, shape[1])
    most = _MOST_COPIED * (part.right - part.left) * (part.bottom - part.top)
    if top >= bottom or left >= right or (bottom - top) * (right - left) > most:
        return None
    return slice(top, bottom), slice(left, right)
