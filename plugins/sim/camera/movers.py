"""The appearance of moving objects: robots and boxes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from ..models import outline_m
from .light import SIDES
from .solids import Block, Drum, Face, Plane, Point, Tower
from .texture import Image, Mipmap, samples

_PER_M: Final = 400.0
_DARK, _GLASS, _PALE, _RED = (38, 40, 44), (24, 30, 40), (238, 238, 232), (205, 40, 35)
SHADOW_M: Final = 0.16
"""Width of the contact shadow around an object on the floor."""

_SHADOW_DARK: Final = 0.5
_SIDE_NUMBERS: Final = np.arange(SIDES + 1)


@dataclass(frozen=True)
class RobotAppearance:
    """The appearance of a make of robot.

    Attributes:
        radius_m: of the robot, an upright disc.
        height_m: from the floor to its top.
        colour: red, green and blue.
        camera_height_m: of its own camera over the floor.
    """

    radius_m: float
    height_m: float
    colour: tuple[int, int, int]
    camera_height_m: float


@dataclass(frozen=True)
class RobotAt:
    """A robot in view.

    Attributes:
        head_yaw_rad: its turret's angle from straight ahead.
    """

    appearance: RobotAppearance
    x_m: float
    y_m: float
    yaw_rad: float
    head_yaw_rad: float = 0.0


@dataclass(frozen=True)
class BoxAt:
    """A movable box in view.

    Attributes:
        number: index among the world's boxes, from 0.
        x_m: x of its centre.
        y_m: y of its centre.
    """

    number: int
    x_m: float
    y_m: float
    yaw_rad: float


Mover = RobotAt | BoxAt


@dataclass(frozen=True)
class RobotKit:
    """A robot at the origin, facing along x, and its shadow on the floor."""

    drums: tuple[Drum, ...]
    shadow: Mipmap

    @classmethod
    def of(cls, appearance: RobotAppearance) -> RobotKit:
        """Return the robot of an appearance."""
        base, *heads = outline_m(appearance.radius_m, appearance.height_m, appearance.camera_height_m)
        drums = [_drum(appearance, base[0], (0.0, base[1]), _body_side, _body_top)]
        drums += [_drum(appearance, radius_m, (base[1], top_m), _head_side, _head_top) for radius_m, top_m in heads]
        return cls(tuple(drums), disc_shadow(appearance.radius_m))

    @property
    def middle_m(self) -> float:
        """Half its height."""
        return self.drums[-1].height_m / 2

    def at(self, robot: RobotAt, gains: NDArray[np.float64]) -> Tower:
        """Return the robot at its pose, with the gains of `RoomLight.around` there."""
        middle = robot.x_m, robot.y_m
        placed = []
        for number, drum in enumerate(self.drums):
            yaw_rad = robot.yaw_rad + (robot.head_yaw_rad if number else 0.0)
            top = Plane(drum.top.height_m, middle, yaw_rad, drum.top.texture, float(gains[-1]))
            heights_m = drum.bottom_m, drum.height_m
            placed.append(Drum(middle, drum.radius_m, *heights_m, yaw_rad, drum.side, top, gains[:-1]))
        return Tower(tuple(placed))


@dataclass(frozen=True)
class BoxKit:
    """A movable box at the origin, and its shadow on the floor."""

    block: Block
    shadow: Mipmap

    @property
    def middle_m(self) -> float:
        """Half its height."""
        return self.block.height_m / 2

    def at(self, box: BoxAt, gains: NDArray[np.float64]) -> Block:
        """Return the box at its pose, with the gains of `RoomLight.around` there."""
        cos, sin = math.cos(box.yaw_rad), math.sin(box.yaw_rad)

        def moved(point: Point) -> Point:
            return box.x_m + cos * point[0] - sin * point[1], box.y_m + sin * point[0] + cos * point[1]

        turns = [math.atan2(face.normal[1], face.normal[0]) + box.yaw_rad for face in self.block.faces]
        places = [(turn / (2 * math.pi) + 0.5) % 1.0 * SIDES for turn in turns]
        faces = [
            Face(moved(face.left), moved(face.right), face.bottom_m, face.top_m, face.texture, face.offset_m, gain)
            for face, gain in zip(self.block.faces, np.interp(places, _SIDE_NUMBERS, gains[:-1]).tolist(), strict=True)
        ]
        top = Plane(self.block.top.height_m, (box.x_m, box.y_m), box.yaw_rad, self.block.top.texture, float(gains[-1]))
        return Block(tuple(moved(corner) for corner in self.block.corners), self.block.height_m, tuple(faces), top)


def disc_shadow(radius_m: float) -> Mipmap:
    """Return the shadow around a disc, as factors on the floor's colours."""
    return box_shadow((0.0, 0.0), radius_m)


def box_shadow(size_m: tuple[float, float], radius_m: float = 0.0) -> Mipmap:
    """Return the shadow around a rectangle with rounded corners, as factors on the floor's colours; 255 is 1."""
    reach_m = radius_m + SHADOW_M
    whole_m = size_m[0] + 2 * reach_m, size_m[1] + 2 * reach_m
    x_m, y_m = (np.linspace(-length_m / 2, length_m / 2, samples(length_m, 80.0)) for length_m in whole_m)
    outside = (np.maximum(np.abs(place) - size / 2, 0) for place, size in zip((x_m, y_m), size_m, strict=True))
    away_x, away_y = outside
    away_m = np.maximum(np.hypot(away_x[np.newaxis], away_y[:, np.newaxis]) - radius_m, 0)
    fade = np.clip(1 - away_m / SHADOW_M, 0, 1)
    factors = 255 * (1 - _SHADOW_DARK * fade**2)
    return Mipmap(np.repeat(factors[..., np.newaxis], 4, axis=2).astype(np.uint8), whole_m)


def _drum(appearance: RobotAppearance, radius_m: float, heights_m: tuple[float, float], side: Any, top: Any) -> Drum:
    bottom_m, height_m = heights_m
    size_m = 2 * math.pi * radius_m, height_m - bottom_m
    image = _blank(size_m, appearance.colour)
    side(image, appearance.colour)
    across_m = 2 * radius_m
    disc = _blank((across_m, across_m), appearance.colour)
    top(disc, appearance.colour)
    plane = Plane(height_m, (0.0, 0.0), 0.0, Mipmap(disc, (across_m, across_m)))
    return Drum((0.0, 0.0), radius_m, bottom_m, height_m, 0.0, Mipmap(image, size_m), plane)


def _blank(size_m: tuple[float, float], colour: tuple[int, int, int]) -> Image:
    columns, rows = (samples(length_m, _PER_M) for length_m in size_m)
    image = np.full((rows, columns, 4), 255, np.uint8)
    image[..., :3] = colour
    return image


def _body_side(image: Image, colour: tuple[int, int, int]) -> None:
    """Draw a skirt with wheels, panels, a pale band, an arrow and lamps in front, and red lamps at the back."""
    rows, columns = image.shape[:2]
    image[: max(1, rows // 24), :, :3] = _shade(colour, 1.25)
    for seam in range(8):
        at = columns * (2 * seam + 1) // 16
        image[:, at : at + 2, :3] = _shade(colour, 0.6)
    _bar(image, (0.0, 1.0), (0.72, 1.0), _DARK)
    for middle in (0.25, 0.75):  # the wheels, right and left
        _bar(image, (middle - 0.07, middle + 0.07), (0.66, 1.0), (18, 18, 20))
        for spoke in range(5):
            at = middle - 0.06 + 0.12 * spoke / 4
            _bar(image, (at - 0.004, at + 0.004), (0.7, 1.0), (62, 62, 66))
    _bar(image, (0.0, 1.0), (0.56, 0.62), _PALE)
    _bar(image, (0.42, 0.58), (0.14, 0.5), _GLASS)
    for side in (-1, 1):
        _spot(image, (0.5 + side * 0.055, 0.32), 0.1, (250, 244, 200))
        _bar(image, (0.02 if side > 0 else 0.93, 0.07 if side > 0 else 0.98), (0.2, 0.36), _RED)


def _head_side(image: Image, colour: tuple[int, int, int]) -> None:
    """Draw a dark window with the lens of the camera in front, and vents at the back."""
    image[..., :3] = _shade(colour, 0.82)
    _bar(image, (0.0, 1.0), (0.0, 0.06), _DARK)
    _bar(image, (0.0, 1.0), (0.92, 1.0), _DARK)
    _bar(image, (0.34, 0.66), (0.2, 0.62), _GLASS)
    _spot(image, (0.5, 0.41), 0.17, (92, 104, 122))
    _spot(image, (0.5, 0.41), 0.11, (12, 14, 18))
    _spot(image, (0.507, 0.37), 0.03, (225, 235, 245))
    for vent in range(4):
        for left, right in ((0.0, 0.1), (0.9, 1.0)):
            _bar(image, (left, right), (0.25 + 0.14 * vent, 0.31 + 0.14 * vent), _shade(colour, 0.4))


def _body_top(image: Image, colour: tuple[int, int, int]) -> None:
    """Draw a lid with a rim, and an arrow that points ahead."""
    _disc(image, 0.5, _shade(colour, 1.12))
    _disc(image, 0.44, _shade(colour, 0.9))
    _disc(image, 0.43, _shade(colour, 1.05))
    _disc(image, 0.2, _shade(colour, 0.75))
    side = image.shape[0] - 1
    arrow = np.array([[0.94, 0.5], [0.7, 0.66], [0.7, 0.34]]) * side
    cv2.fillConvexPoly(image, np.rint(arrow * 16).astype(np.int32), (*_PALE, 255), cv2.LINE_AA, 4)


def _head_top(image: Image, colour: tuple[int, int, int]) -> None:
    _body_top(image, _shade(colour, 0.9))


def _disc(image: Image, share: float, colour: tuple[int, int, int]) -> None:
    side = image.shape[0] - 1
    cv2.circle(image, (side * 8, side * 8), round(share * side * 16), (*colour, 255), -1, cv2.LINE_AA, 4)


def _bar(image: Image, along: tuple[float, float], down: tuple[float, float], colour: tuple[int, int, int]) -> None:
    rows, columns = image.shape[:2]
    left, right = (round(share * columns) for share in along)
    top, bottom = (round(share * rows) for share in down)
    image[top:bottom, left:right, :3] = colour


def _spot(image: Image, place: tuple[float, float], share: float, colour: tuple[int, int, int]) -> None:
    """Draw a disc, its radius a share of the height."""
    rows, columns = image.shape[:2]
    centre = round(place[0] * (columns - 1) * 16), round(place[1] * (rows - 1) * 16)
    cv2.circle(image, centre, round(share * rows * 16), (*colour, 255), -1, cv2.LINE_AA, 4)


def _shade(colour: tuple[int, int, int], factor: float) -> tuple[int, int, int]:
    red, green, blue = (min(255, round(channel * factor)) for channel in colour)
    return red, green, blue
