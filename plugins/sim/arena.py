"""The geometry of a world file: its solid parts in a physics space, start places, drops, and a space for queries."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, Protocol, TypeAlias

import pymunk

from eal_actors.device.world import WorldModel

Pose2D: TypeAlias = tuple[float, float, float]
"""x and y in metres, yaw in radians, unwrapped."""

WALL_RADIUS_M: Final = 0.1
"""Rounding radius of the walls: they are thick, so that nothing passes them in one tick."""

_PITCHES_M: Final = (1.0, 0.5)  # of the grid of places, the coarser first
_MOST_CELLS: Final = 100
"""Places of the grid on each side of the centre: a room may be 10 km long."""
_WALL_FRICTION: Final = 0.5
_WALL_NAMES: Final = ("west", "south", "east", "north")  # in the order of `_walls`


def add_solids(space: pymunk.Space, model: WorldModel) -> dict[pymunk.Shape, str]:
    """Add the walls, obstacles and beacons of a world to a space; return a readable name for each shape."""
    body = space.static_body
    named: dict[pymunk.Shape, str] = {}
    for wall, shape in zip(_WALL_NAMES, _walls(body, *model.size_m), strict=True):
        named[shape] = f"the {wall} wall"
    for number, shape in enumerate(_obstacles(body, model)):
        obstacle = model.obstacles[number]
        where = "" if obstacle.kind == "wall" else f" at x {obstacle.x_m:g} m, y {obstacle.y_m:g} m"
        named[shape] = f"obstacles[{number}] ({obstacle.kind}{where})"
    for beacon in model.beacons:
        named[pymunk.Circle(body, beacon.radius_m, (beacon.x_m, beacon.y_m))] = f"beacon {beacon.name}"
    for shape in named:
        shape.friction = _WALL_FRICTION
    space.add(*named)
    return named


def places(model: WorldModel) -> Iterator[Pose2D]:
    """Yield places for robots without a start pose: the world's start poses, then a grid."""
    for start in model.start_poses:
        yield start.x_m, start.y_m, math.radians(start.yaw_deg)
    for x_m, y_m in _grid(*model.size_m):
        yield x_m, y_m, 0.0


def is_inside(model: WorldModel, x_m: float, y_m: float, radius_m: float) -> bool:
    """Return whether a robot there is within the walls."""
    width_m, depth_m = model.size_m
    return abs(x_m) + radius_m <= width_m / 2 and abs(y_m) + radius_m <= depth_m / 2


def is_on_floor(model: WorldModel, pose: Pose2D, radius_m: float) -> bool:
    """Return whether no part of a disc is over a drop."""
    return all(distance_m >= radius_m for distance_m in distances_to_drops_m(model, *pose[:2]))


def distances_to_drops_m(model: WorldModel, x_m: float, y_m: float) -> list[float]:
    """Return the distance of a point from each drop of a world; 0 inside."""
    found = []
    for drop in model.drops:
        yaw_rad = math.radians(drop.yaw_deg)
        cos, sin, dx, dy = math.cos(yaw_rad), math.sin(yaw_rad), x_m - drop.x_m, y_m - drop.y_m
        ahead_m, left_m = abs(cos * dx + sin * dy), abs(cos * dy - sin * dx)
        found.append(math.hypot(max(0.0, ahead_m - drop.size_m[0] / 2), max(0.0, left_m - drop.size_m[1] / 2)))
    return found


def corners(size_m: tuple[float, float]) -> list[tuple[float, float]]:
    """Return the corners of a rectangle centred on the origin."""
    half_x, half_y = size_m[0] / 2, size_m[1] / 2
    return [(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)]


class Positioned(Protocol):
    """An object with a pose: a robot or a box."""

    @property
    def pose(self) -> Pose2D:
        """The current pose."""


class QuerySpace:
    """A physics space for queries: the walls and obstacles of a world, and the current shapes of robots and boxes.

    It is updated on access only. Motion and contact use another space, so that no query can change a path.

    Attributes:
        is_stale: whether something may have moved since the last query.
        names: a readable name for each shape.

    Thread: every member is for the holder of the world's lock.
    """

    def __init__(self, model: WorldModel) -> None:
        self.is_stale = False
        self._space = pymunk.Space()
        self.names = add_solids(self._space, model)
        self._bodies: dict[Positioned, tuple[pymunk.Body, Pose2D]] = {}

    def add_disc(self, item: Positioned, name: str, radius_m: float, shape_filter: pymunk.ShapeFilter) -> None:
        """Add a robot."""
        body = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        disc = pymunk.Circle(body, radius_m)
        disc.filter = shape_filter
        self._add(item, body, disc, name)

    def add_box(self, item: Positioned, name: str, size_m: tuple[float, float]) -> None:
        """Add a movable box."""
        body = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        self._add(item, body, pymunk.Poly(body, corners(size_m)), name)

    @property
    def space(self) -> pymunk.Space:
        """The space, up to date."""
        if self.is_stale:
            self.is_stale = False
            for item, (body, known_pose) in self._bodies.items():
                if item.pose != known_pose:
                    self._set_pose(item, body)
                    self._space.reindex_shapes_for_body(body)
        return self._space

    def _add(self, item: Positioned, body: pymunk.Body, shape: pymunk.Shape, name: str) -> None:
        self.names[shape] = name
        self._set_pose(item, body)
        self._space.add(body, shape)

    def _set_pose(self, item: Positioned, body: pymunk.Body) -> None:
        pose = item.pose
        body.position, body.angle = pose[:2], pose[2]
        self._bodies[item] = body, pose


def _grid(width_m: float, height_m: float) -> list[tuple[float, float]]:
    """Return places around the centre, the inner ones first; a coarse grid, then a finer one."""
    spots = []
    for pitch_m in _PITCHES_M:
        cells = ((size_m / 2 - pitch_m / 2) / pitch_m for size_m in (width_m, height_m))
        columns, rows = (math.floor(min(max(0.0, number), _MOST_CELLS)) for number in cells)
        grid = [(x * pitch_m, y * pitch_m) for x in range(-columns, columns + 1) for y in range(-rows, rows + 1)]
        spots += sorted(grid, key=lambda spot: (math.hypot(*spot), spot))
    return spots


def _walls(body: pymunk.Body, width_m: float, height_m: float) -> list[pymunk.Shape]:
    ends = corners((width_m + 2 * WALL_RADIUS_M, height_m + 2 * WALL_RADIUS_M))
    return [pymunk.Segment(body, ends[i - 1], ends[i], WALL_RADIUS_M) for i in range(4)]


def _obstacles(body: pymunk.Body, model: WorldModel) -> list[pymunk.Shape]:
    shapes: list[pymunk.Shape] = []
    for obstacle in model.solid_obstacles:
        place = pymunk.Transform.translation(obstacle.x_m, obstacle.y_m)
        if obstacle.kind == "circle":
            shapes.append(pymunk.Circle(body, obstacle.radius_m, (obstacle.x_m, obstacle.y_m)))
        else:
            turned = place.rotated(math.radians(obstacle.yaw_deg))
            shapes.append(pymunk.Poly(body, corners(obstacle.size_m), turned))
    return shapes
