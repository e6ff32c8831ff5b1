"""Solids in a room: upright blocks and drums, and the faces of solids and walls."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .texture import Mipmap

Point = tuple[float, float]


@dataclass(frozen=True)
class Face:
    """An upright rectangle, visible from one side only.

    Attributes:
        left: its left end, seen from the visible side, x and y in metres.
        right: its other end.
        bottom_m: height of its lower edge over the floor.
        top_m: height of its upper edge.
        texture: what it looks like; the texture's upper edge is at `top_m`.
        offset_m: how far its left end is from the texture's left edge.
        gain: how bright it is; 1 where the light is in the texture.
        continues: whether another face goes on where it ends, on the left and on the right.
    """

    left: Point
    right: Point
    bottom_m: float
    top_m: float
    texture: Mipmap
    offset_m: float = 0.0
    gain: float = 1.0
    continues: tuple[bool, bool] = (False, False)

    @cached_property
    def along(self) -> Point:
        """Unit vector from the left end to the right end."""
        length_m = math.dist(self.left, self.right)
        return (self.right[0] - self.left[0]) / length_m, (self.right[1] - self.left[1]) / length_m

    @property
    def normal(self) -> Point:
        """Unit vector towards the visible side."""
        return self.along[1], -self.along[0]


class Plane(NamedTuple):
    """A level surface, such as the floor or the top of a block.

    Attributes:
        height_m: over the floor.
        middle: of its texture, x and y in metres.
        yaw_rad: of its texture's width, counter-clockwise from the x axis.
        texture: what it looks like from above; for a ceiling too.
        gain: how bright it is; 1 where the light is in the texture.
    """

    height_m: float
    middle: Point
    yaw_rad: float
    texture: Mipmap
    gain: float = 1.0


@dataclass(frozen=True)
class Block:
    """A convex block that stands on the floor.

    Attributes:
        corners: counter-clockwise, x and y in metres.
        height_m: of its top.
        faces: those that can be seen.
    """

    corners: tuple[Point, ...]
    height_m: float
    faces: tuple[Face, ...]
    top: Plane


class Drum(NamedTuple):
    """An upright cylinder.

    Attributes:
        middle: x and y in metres.
        bottom_m: height of its lower end over the floor.
        height_m: of its top over the floor.
        yaw_rad: where the middle of its side's texture faces, counter-clockwise from the x axis.
        side: its side, unrolled; left to right as it is seen from outside.
        gains: how bright its side is where it faces against x, and on counter-clockwise in equal steps back to there,
            (n,); None where the light is in the texture.
    """

    middle: Point
    radius_m: float
    bottom_m: float
    height_m: float
    yaw_rad: float
    side: Mipmap
    top: Plane
    gains: NDArray[np.float64] | None = None


class Tower(NamedTuple):
    """Stacked drums on one axis, from the lowest and widest up."""

    drums: tuple[Drum, ...]


Solid = Block | Tower
