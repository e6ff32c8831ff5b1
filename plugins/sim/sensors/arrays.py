"""All objects inside the walls as arrays, and what the sensors of one world share."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from eal_actors.plugin import UnavailableError

from ..robot import SimRobot
from ..world import SimBox, SimWorld
from .geometry import Array, Span, disc_span_m, rectangle_span_m

if TYPE_CHECKING:
    from numpy.typing import NDArray

_Row: TypeAlias = tuple[float, float, float, float, float, float, float]
"""x, y, yaw, radius, half x, half y, height."""

Columns: TypeAlias = "NDArray[np.intp] | slice"

_UPRIGHT: Final = (np.array(1.0), np.array(0.0))

_T = TypeVar("_T")

_SHARED: Final[WeakKeyDictionary[SimWorld, dict[type, Any]]] = WeakKeyDictionary()
"""The shared objects must not refer to their world, nor to a robot, which refers to it: that would leak the world."""


def shared(world: SimWorld, kind: type[_T]) -> _T:
    """Return the world's one object of a class; create it without arguments on first use.

    Thread: holds the world's `lock`.
    """
    objects = _SHARED.setdefault(world, {})
    if kind not in objects:
        objects[kind] = kind()
    found: _T = objects[kind]
    return found


class WorldArrays:
    """The bodies of a world, one column each.

    The discs come first: robots, beacons, pillars. The rectangles follow: movable boxes, blocks. Bodies that can block
    a line of sight begin with the pillars: robots are low and beacons thin.

    Attributes:
        version: the world's version at the last update; -1 before the first.
        first_opaque: the column of the first pillar.
        first_rectangle: the column of the first rectangle.
        x_m: centres, shape (n,), as all the others.
        y_m: centres.
        yaw_rad: unwrapped.
        radius_m: of the disc, or of the circle around the rectangle.
        half_x_m: half of a rectangle's extent along its own x axis; 0 for a disc.
        half_y_m: likewise along its y axis.
        height_m: from the floor to the top; 0 for robots.
        half_room_m: half of the room's extent along x and along y.

    Thread: holds the world's `lock`.
    """

    first_opaque: int
    first_rectangle: int
    x_m: Array
    y_m: Array
    yaw_rad: Array
    cos: Array
    sin: Array
    radius_m: Array
    half_x_m: Array
    half_y_m: Array
    height_m: Array
    half_room_m: Span

    def __init__(self) -> None:
        self.version = -1
        self._rows: dict[str, int] = {}

    def update(self, world: SimWorld) -> None:
        """Update the columns, if anything in the world has another pose since the last update."""
        if self.version == world.version:
            return
        robots, boxes = world.robots, world.boxes
        if len(robots) != len(self._rows) or self.version < 0:
            self._build(world, robots, boxes)
        if robots:
            self._poses[:, : len(robots)] = np.array([robot.pose for robot in robots]).T
        if boxes:
            first = self.first_rectangle
            self._poses[:, first : first + len(boxes)] = np.array([box.pose for box in boxes]).T
        self.cos, self.sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        self.version = world.version

    def column_of(self, robot: str) -> int:
        """Return the column of the robot of that name.

        Raises:
            UnavailableError: the robot has no place in the world.
        """
        row = self._rows.get(robot)
        if row is None:
            raise UnavailableError(f"the simulated world has no free place for robot {robot!r}")
        return row

    def spans_m(self, x_m: float, y_m: float, ux: Array, uy: Array) -> Span:
        """Return the spans of lines from one point in all bodies, each of shape (lines, n).

        The unit directions of the lines have the shape (lines, 1).
        """
        dx, dy = self.x_m - x_m, self.y_m - y_m
        discs, rectangles = slice(self.first_rectangle), slice(self.first_rectangle, None)
        found = (
            self.disc_span_m(discs, dx[discs], dy[discs], ux, uy),
            self.rectangle_span_m(rectangles, dx[rectangles], dy[rectangles], ux, uy),
        )
        enter_m, leave_m = (np.concatenate(side, axis=1) for side in zip(*found, strict=True))
        return enter_m, leave_m

    def to_walls_m(self, x_m: Array, y_m: Array, ux: Array, uy: Array) -> Array:
        """Return the distances from points to the walls of the room, along unit directions."""
        return rectangle_span_m(-x_m, -y_m, ux, uy, *_UPRIGHT, *self.half_room_m)[1]

    def disc_span_m(self, bodies: Columns, dx: Array, dy: Array, ux: Array, uy: Array) -> Span:
        """Return the spans of lines in some of the discs; see geometry.disc_span_m."""
        return disc_span_m(dx, dy, ux, uy, self.radius_m[bodies])

    def rectangle_span_m(self, bodies: Columns, dx: Array, dy: Array, ux: Array, uy: Array) -> Span:
        """Return the spans of lines in some of the rectangles; see geometry.rectangle_span_m."""
        axes = self.cos[bodies], self.sin[bodies], self.half_x_m[bodies], self.half_y_m[bodies]
        return rectangle_span_m(dx, dy, ux, uy, *axes)

    def _build(self, world: SimWorld, robots: tuple[SimRobot, ...], boxes: tuple[SimBox, ...]) -> None:
        model = world.model
        self.half_room_m = np.array(model.size_m[0] / 2), np.array(model.size_m[1] / 2)
        self._rows = {robot.name: row for row, robot in enumerate(robots)}
        obstacles = model.solid_obstacles
        radii_m = (robot.make.radius_m if world.is_solid else math.nan for robot in robots)  # NaN meets no line
        low: list[_Row] = [_disc_row(0.0, 0.0, radius_m, 0.0) for radius_m in radii_m]
        low += [_disc_row(post.x_m, post.y_m, post.radius_m, post.height_m) for post in model.beacons]
        pillars = [_disc_row(o.x_m, o.y_m, o.radius_m, o.height_m) for o in obstacles if o.kind == "circle"]
        movable = [box.model for box in boxes]
        rectangles = [_rectangle_row(b.x_m, b.y_m, b.yaw_deg, b.size_m, b.height_m) for b in movable]
        rectangles += [
            _rectangle_row(o.x_m, o.y_m, o.yaw_deg, o.size_m, o.height_m) for o in obstacles if o.kind == "box"
        ]
        self.first_opaque, self.first_rectangle = len(low), len(low) + len(pillars)
        bodies = [*low, *pillars, *rectangles]
        columns: Array = np.array(bodies, dtype=np.float64).reshape(len(bodies), 7).T.copy()
        self._poses = columns[:3]
        self.x_m, self.y_m, self.yaw_rad, self.radius_m, self.half_x_m, self.half_y_m, self.height_m = columns


def _disc_row(x_m: float, y_m: float, radius_m: float, height_m: float) -> _Row:
    return x_m, y_m, 0.0, radius_m, 0.0, 0.0, height_m


def _rectangle_row(x_m: float, y_m: float, yaw_deg: float, size_m: tuple[float, float], height_m: float) -> _Row:
    half_x, half_y = size_m[0] / 2, size_m[1] / 2
    return x_m, y_m, math.radians(yaw_deg), math.hypot(half_x, half_y), half_x, half_y, height_m
