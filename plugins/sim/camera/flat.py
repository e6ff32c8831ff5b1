"""Flat surfaces: each is warped to the image by its homography."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from .eye import NEAR_M, Eye, Floats
from .layers import Layer, Rect
from .solids import Face, Plane, Point
from .texture import PAD, Image, Texture

_Matrix = NDArray[np.float64]
_WARP = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
_WHITE = (255, 255, 255, 255)
_NARROW_PX = 16  # OpenCV is slow at what is narrower
_HORIZON_PX = 0.25  # what is nearer to the horizon is taken to be there


def face_layers(eye: Eye, faces: Sequence[Face], *, closed: bool = False) -> list[Layer]:
    """Return the layers of those faces that are seen, from left to right.

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
    normal_x, normal_y = face.normal
    distance_m = (eye.x_m - face.left[0]) * normal_x + (eye.y_m - face.left[1]) * normal_y
    if distance_m <= 0:
        return None
    ends = _clipped(eye.seen(face.left), eye.seen(face.right))
    if ends is None:
        return None
    left, right = (eye.column(*end) for end in ends)
    end = eye.lens.width - 0.5
    if right <= max(left, -0.5) or left >= end:
        return None
    first, last = math.floor(max(left, 0.0) + 0.5), math.floor(min(right, end - 0.5) + 0.5)
    step = _across(eye.right, face.normal) / eye.focal_px / -distance_m
    start = _across(eye.ahead, face.normal) / -distance_m - eye.centre_px[0] * step
    nearness = start + step * np.arange(first, last + 1)
    least, most = sorted(1 / ahead_m for _, ahead_m in ends)
    nearness[0], nearness[-1] = (min(max(nearness[side], least), most) for side in (0, -1))
    return Layer(
        first,
        eye.rows(face.top_m, nearness),
        eye.rows(face.bottom_m, nearness),
        lambda rect: _fill_face(eye, face, distance_m, rect, nearness),
        left_share=1.0 if left < -0.5 else first + 0.5 - left,
        right_share=1.0 if right > end else min(1.0, right - max(last - 0.5, left)),
    )


def _across(vector: Point, other: Point) -> float:
    return vector[0] * other[0] + vector[1] * other[1]


def _clipped(left: Point, right: Point) -> tuple[Point, Point] | None:
    """Return both ends, right and ahead, cut off where they are not in front of the camera; None without a rest."""
    (x0, z0), (x1, z1) = left, right
    if z0 < NEAR_M and z1 < NEAR_M:
        return None
    if z0 < NEAR_M:
        left = x1 + (x0 - x1) * (z1 - NEAR_M) / (z1 - z0), NEAR_M
    elif z1 < NEAR_M:
        right = x0 + (x1 - x0) * (z0 - NEAR_M) / (z0 - z1), NEAR_M
    return left, right


def _fill_face(eye: Eye, face: Face, distance_m: float, rect: Rect, nearness: Floats) -> Image:
    texture, per_px = face.texture, 1 / eye.focal_px

    def levels(ahead_m: float) -> tuple[int, int]:
        along = texture.level(ahead_m**2 / distance_m * per_px * texture.per_m[0], 0)
        return along, texture.level(ahead_m * per_px * texture.per_m[1], 1)

    matrix = face_homography(eye, face, distance_m)
    colours = np.empty((rect.bottom - rect.top, rect.right - rect.left, 4), np.uint8)
    everywhere = levels(1 / float(nearness[0]))
    if everywhere == levels(1 / float(nearness[-1])):
        _warp(texture, everywhere, matrix, rect, colours)
    else:
        ahead_m = 1 / nearness
        along = texture.levels(ahead_m**2 / distance_m * per_px * texture.per_m[0], 0)
        across = texture.levels(ahead_m * per_px * texture.per_m[1], 1)
        for start, end in _runs(along * 64 + across, _NARROW_PX):
            part = Rect(rect.left + start, rect.left + end, rect.top, rect.bottom)
            _warp(texture, (int(along[start]), int(across[start])), matrix, part, colours[:, start:end])
    return _dimmed(colours, face.gain)


def face_homography(eye: Eye, face: Face, distance_m: float) -> _Matrix:
    """Return the matrix from homogeneous columns and rows to samples of the face's texture, (3, 3)."""
    column, row = eye.centre_px
    focal_px = eye.focal_px
    to_eye_m = _across((eye.x_m - face.left[0], eye.y_m - face.left[1]), face.along) + face.offset_m
    scale_step, along_step = (_across(eye.right, vector) / focal_px for vector in (face.normal, face.along))
    scale = _across(eye.ahead, face.normal) - column * scale_step
    along = _across(eye.ahead, face.along) - column * along_step
    per_x, per_y = face.texture.per_m
    above_m = face.top_m - eye.z_m
    return np.array(
        [
            [
                per_x * (to_eye_m * scale_step - distance_m * along_step),
                0,
                per_x * (to_eye_m * scale - distance_m * along),
            ],
            [
                per_y * above_m * scale_step,
                -per_y * distance_m / focal_px,
                per_y * (above_m * scale + distance_m * row / focal_px),
            ],
            [scale_step, 0.0, scale],
        ]
    )


def plane_homography(eye: Eye, plane: Plane) -> _Matrix:
    """Return the matrix from homogeneous columns and rows to samples of the plane's texture, (3, 3)."""
    column, row = eye.centre_px
    below_m = eye.z_m - plane.height_m
    cos, sin = math.cos(plane.yaw_rad), math.sin(plane.yaw_rad)
    to_eye = eye.x_m - plane.middle[0], eye.y_m - plane.middle[1]

    def line(vector: Point, edge_m: float, per_m: float) -> list[float]:
        step = below_m * _across(eye.right, vector)
        at_m = _across(to_eye, vector) + edge_m
        start = below_m * eye.focal_px * _across(eye.ahead, vector) - column * step - at_m * row
        return [per_m * step, per_m * at_m, per_m * start]

    (width_m, height_m), (per_x, per_y) = plane.texture.size_m, plane.texture.per_m
    return np.array([line((cos, sin), width_m / 2, per_x), line((sin, -cos), height_m / 2, per_y), [0.0, 1.0, -row]])


def fill_plane(eye: Eye, plane: Plane, rect: Rect) -> Image:
    """Return the colours of a level surface in a part of the image, which must be on its side of the horizon."""
    texture = plane.texture
    below_m = eye.z_m - plane.height_m
    per_px = min(texture.per_m) / eye.focal_px / math.sqrt(abs(below_m))

    def levels(rows: NDArray[np.intp]) -> NDArray[np.intp]:
        down = np.abs(rows - eye.centre_px[1])
        ahead_m = eye.focal_px * abs(below_m) / np.maximum(down, _HORIZON_PX)
        wanted = ahead_m**1.5 * per_px  # a compromise: pixels are long and narrow on it
        return np.minimum(texture.levels(wanted, 0), texture.levels(wanted, 1))

    matrix = plane_homography(eye, plane)
    colours = np.empty((rect.bottom - rect.top, rect.right - rect.left, 4), np.uint8)
    level = levels(np.arange(rect.top, rect.bottom))
    for start, end in _runs(level):
        part = Rect(rect.left, rect.right, rect.top + start, rect.top + end)
        _warp(texture, (int(level[start]), int(level[start])), matrix, part, colours[start:end])
    return _dimmed(colours, plane.gain)


def fill_near_plane(eye: Eye, plane: Plane, rect: Rect) -> Image:
    """Return the same where the texture is so coarse that no pixel holds several samples."""
    colours = np.empty((rect.bottom - rect.top, rect.right - rect.left, 4), np.uint8)
    _warp(plane.texture, (0, 0), plane_homography(eye, plane), rect, colours)
    return colours


def polygon_layer(eye: Eye, plane: Plane, corners: Sequence[Point]) -> Layer | None:
    """Return the layer of the part of a level surface below the camera that a convex polygon bounds.

    Args:
        eye: the camera.
        plane: the surface.
        corners: counter-clockwise, x and y in metres.
    """
    seen = [eye.seen(corner) for corner in corners]
    nearest_m, farthest_m = min(ahead_m for _, ahead_m in seen), max(ahead_m for _, ahead_m in seen)
    if eye.z_m <= plane.height_m or farthest_m <= NEAR_M:
        return None
    left, right = -0.5, eye.lens.width - 0.5
    if nearest_m > NEAR_M:
        columns = [eye.column(*point) for point in seen]
        left, right = max(left, min(columns)), min(right, max(columns))
    if left >= right:
        return None
    first, last = math.floor(left + 0.5), min(math.floor(right + 0.5), eye.lens.width - 1)
    entered_m, left_m = _crossed(np.array(seen), eye.slopes[first : last + 1])
    return Layer(
        first,
        eye.rows(plane.height_m, 1 / np.maximum(left_m, entered_m)),
        eye.rows(plane.height_m, 1 / entered_m),
        lambda rect: fill_plane(eye, plane, rect),
        left_share=min(1.0, first + 0.5 - left),
        right_share=min(1.0, right - (last - 0.5)),
    )


def _crossed(
    corners: NDArray[np.float64], slopes: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far ahead the ray of each column enters and leaves a counter-clockwise polygon of the plan."""
    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1)  # outwards, with x to the right and y ahead
    offsets = (normals * corners).sum(axis=1)
    speeds = slopes[:, np.newaxis] * normals[:, 0] + normals[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        meets_m = offsets / speeds
    entered = np.where(speeds < 0, meets_m, NEAR_M).max(axis=1)
    left = np.where(speeds > 0, meets_m, np.inf).min(axis=1)
    return np.maximum(entered, NEAR_M), np.maximum(left, NEAR_M)


def _dimmed(colours: Image, gain: float) -> Image:
    return colours if gain == 1.0 else np.asarray(cv2.convertScaleAbs(colours, alpha=gain), dtype=np.uint8)


def _runs(levels: NDArray[np.intp], least: int = 1) -> Iterator[tuple[int, int]]:
    """Yield start and end of each run of equal numbers; one that is shorter than the least is part of its neighbour."""
    start, size = 0, len(levels)
    for change in (np.flatnonzero(np.diff(levels)) + 1).tolist():
        if least <= change - start and least <= size - change:
            yield start, change
            start = change
    yield start, size


def _warp(texture: Texture, level: tuple[int, int], matrix: _Matrix, part: Rect, target: Image) -> None:
    """Warp a version of a texture into an array for a part of the image."""
    moved = matrix.copy()
    moved[:, 2] += matrix[:, 0] * part.left + matrix[:, 1] * part.top
    moved[0] = moved[0] * 0.5 ** level[0] + PAD * moved[2]
    moved[1] = moved[1] * 0.5 ** level[1] + PAD * moved[2]
    cv2.warpPerspective(
        texture.version(*level),
        moved,
        (part.right - part.left, part.bottom - part.top),
        dst=target,
        flags=_WARP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=_WHITE,
    )
