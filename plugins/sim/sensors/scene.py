"""All that stands inside the walls, as arrays for the sensors' geometry."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from eal_actors.device.world import WorldModel
from eal_actors.plugin import UnavailableError

from ..robot import SimRobot
from ..world import SimBox, SimWorld
from .geometry import Array, Span, disc_span_m, rectangle_span_m

if TYPE_CHECKING:
    from numpy.typing import NDArray

_Row: TypeAlias = tuple[float, float, float, float, float, float, float]
"""x, y, yaw, radius, half x, half y, height."""

Columns: TypeAlias = "NDArray[np.intp] | slice"


class Scene:
    """The bodies of a world, one column each, kept up with the world.

    First come the discs: robots, beacons, pillars; then the rectangles: movable boxes, blocks. What can hide something
    begins with the pillars: robots are low and beacons thin.

    Attributes:
        version: counts how often the columns have changed.
        first_hiding: the column of the first pillar.
        first_rectangle: the column of the first rectangle.
        x_m: middles, shape (n,), as all the others.
        y_m: middles.
        yaw_rad: unwrapped.
        cos: of the yaw.
        sin: of the yaw.
        radius_m: of the disc, or of the circle round the rectangle.
        half_x_m: half of a rectangle's extent along its own x axis; 0 for a disc.
        half_y_m: likewise along its y axis.
        height_m: from the floor to the top; 0 for robots.
        half_room_m: half of the room's extent along x and along y.

    Thread: inside `caught_up`.
    """

    first_hiding: int
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
        self.version = 0
        self._at_s = math.nan
        self._rows: dict[str, int] = {}

    def follow(self, world: SimWorld, now_s: float) -> None:
        """Bring the columns up to date; within one tick of the world only robots that join can change them."""
        robots, boxes = world.robots, world.boxes
        if len(robots) != len(self._rows) or not self.version:
            self._build(world.model, robots, boxes)
        elif now_s == self._at_s:
            return
        if robots:
            self._poses[:, : len(robots)] = np.array([robot.pose for robot in robots]).T
        if boxes:
            first = self.first_rectangle
            self._poses[:, first : first + len(boxes)] = np.array([box.pose for box in boxes]).T
        self.cos, self.sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        self._at_s = now_s
        self.version += 1

    def row_of(self, robot: str) -> int:
        """Return the column of a robot, which is given by its name.

        Raises:
            UnavailableError: the robot has no place in the world.
        """
        row = self._rows.get(robot)
        if row is None:
            raise UnavailableError(f"the simulated world has no free place for robot {robot!r}")
        return row

    def disc_span_m(self, bodies: Columns, dx: Array, dy: Array, ux: Array, uy: Array) -> Span:
        """Return where lines enter and leave some of the discs, see geometry.disc_span_m."""
        return disc_span_m(dx, dy, ux, uy, self.radius_m[bodies])

    def rectangle_span_m(self, bodies: Columns, dx: Array, dy: Array, ux: Array, uy: Array) -> Span:
        """Return where lines enter and leave some of the rectangles, see geometry.rectangle_span_m."""
        axes = self.cos[bodies], self.sin[bodies], self.half_x_m[bodies], self.half_y_m[bodies]
        return rectangle_span_m(dx, dy, ux, uy, *axes)

    def _build(self, model: WorldModel, robots: tuple[SimRobot, ...], boxes: tuple[SimBox, ...]) -> None:
        self.half_room_m = np.array(model.size_m[0] / 2), np.array(model.size_m[1] / 2)
        self._rows = {robot.name: row for row, robot in enumerate(robots)}
        obstacles = model.solid_obstacles
        low: list[_Row] = [_disc(0.0, 0.0, robot.make.radius_m, 0.0) for robot in robots]
        low += [_disc(post.x_m, post.y_m, post.radius_m, post.height_m) for post in model.beacons]
        pillars = [_disc(o.x_m, o.y_m, o.radius_m, o.height_m) for o in obstacles if o.kind == "circle"]
        movable = [box.model for box in boxes]
        rectangles = [_rectangle(b.x_m, b.y_m, b.yaw_deg, b.size_m, b.height_m) for b in movable]
        rectangles += [_rectangle(o.x_m, o.y_m, o.yaw_deg, o.size_m, o.height_m) for o in obstacles if o.kind == "box"]
        self.first_hiding, self.first_rectangle = len(low), len(low) + len(pillars)
        bodies = [*low, *pillars, *rectangles]
        columns: Array = np.array(bodies, dtype=np.float64).reshape(len(bodies), 7).T.copy()
        self._poses = columns[:3]
        self.x_m, self.y_m, self.yaw_rad, self.radius_m, self.half_x_m, self.half_y_m, self.height_m = columns


def _disc(x_m: float, y_m: float, radius_m: float, height_m: float) -> _Row:
    return x_m, y_m, 0.0, radius_m, 0.0, 0.0, height_m


def _rectangle(x_m: float, y_m: float, yaw_deg: float, size_m: tuple[float, float], height_m: float) -> _Row:
    half_x, half_y = size_m[0] / 2, size_m[1] / 2
    return x_m, y_m, math.radians(yaw_deg), math.hypot(half_x, half_y), half_x, half_y, height_m
