"""The world that all simulated robots of a fleet share."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from typing import Final

import pymunk

from eal_actors.plugin import Clock, PluginError, WorldModel

from .models import Make
from .motion import Motion
from .robot import SUBSTEPS, SimRobot

EMPTY_ROOM: Final = WorldModel(version=1, name="empty-room", size_m=(6.0, 4.0))

_WALL_RADIUS_M: Final = 0.1  # thick, so that nothing passes it in one tick
_SLOP_M: Final = 0.0005  # how far shapes may overlap before they are pushed apart
_PITCHES_M: Final = (1.0, 0.5)  # of the grid of places, the coarser first


class SimWorld:
    """Walls, obstacles and robots in one physics space, which follows the fleet's clock lazily.

    It has no thread: whoever looks at it or changes it does so inside `caught_up`, which first runs the physics
    ticks that have become due. While no robot is driven, nothing can move, and due ticks are skipped.

    A robot's path depends only on the fleet's seed, the robot's name and its motions, as long as robots do not touch
    each other: a motion runs in whole ticks and ends in them, whoever looks and however often.

    Args:
        clock: the fleet's clock.
        seed: the fleet's seed.
        model: size, obstacles and tick rate; None for an empty room.

    Thread: any; one lock.
    """

    def __init__(self, clock: Clock, seed: int = 0, model: WorldModel | None = None) -> None:
        self._model = model or EMPTY_ROOM
        self._clock = clock
        self._seed = seed
        self._lock = threading.Lock()
        self._rate_hz = self._model.physics.rate_hz
        self.tick_s: Final = 1.0 / self._rate_hz
        self._tick = 0
        self._robots: dict[str, SimRobot] = {}
        self._waiting: list[SimRobot] = []
        self._driven: list[SimRobot] = []
        self._groups = count(1)
        self._space = pymunk.Space()
        self._space.collision_slop = _SLOP_M
        self._space.add(*_walls(self._space.static_body, *self._model.size_m))
        self._space.add(*_obstacles(self._space.static_body, self._model))

    def join(self, name: str, make: Make, *, noise: bool, start: tuple[float, float, float] | None) -> SimRobot:
        """Return the robot of that name, which is made and placed if it is new.

        A robot stays in the world for good, as a real one stays where its software ends: joining again finds it
        where it stands.

        Args:
            name: the robot's name.
            make: its make.
            noise: whether its wheels have errors.
            start: x and y in metres and yaw in radians. Without it, it gets a free place of a grid when the world is
                first used: by then the whole fleet has joined, and places are given in the order of the names.

        Raises:
            PluginError: the start is not free, or the robot is there already as another make.
        """
        with self._lock:
            if known := self._robots.get(name):
                if (known.make, known.noise) != (make, noise):
                    raise PluginError(f"robot {name!r} is in the simulated world already, with other settings")
                return known
            robot = SimRobot(name, make, noise=noise, group=next(self._groups), seed=self._seed, tick_s=self.tick_s)
            if start is None:
                self._waiting.append(robot)
            elif self._is_free(start[0], start[1], make.radius_m):
                robot.place(self._space, *start)
            else:
                raise PluginError(
                    f"robot {name!r} cannot start at x {start[0]:g} m, y {start[1]:g} m: it would touch another robot, "
                    f"an obstacle or a wall of the world {self._model.name!r}, or be outside"
                )
            self._robots[name] = robot
            return robot

    @contextmanager
    def caught_up(self) -> Iterator[float]:
        """Hold the lock on a world that is up to date; gives the world's time in seconds of the fleet's clock."""
        with self._lock:
            self._catch_up()
            yield self._tick * self.tick_s

    def start(self, robot: SimRobot, motion: Motion) -> None:
        """Begin a robot's motion with the next tick, in place of a running one. Thread: inside `caught_up`.

        Raises:
            UnavailableError: the robot has no place in the world.
        """
        self.stop(robot)
        robot.start(motion)
        self._driven.append(robot)

    def stop(self, robot: SimRobot) -> None:
        """Stop a robot at once. Thread: inside `caught_up`."""
        if robot.motion is not None:
            robot.stop()
            self._driven.remove(robot)

    def _catch_up(self) -> None:
        if self._waiting:
            self._place_waiting()
        due = math.floor(self._clock.now() * self._rate_hz)
        while self._driven and self._tick < due:
            self._tick += 1
            self._run_tick()
        self._tick = max(self._tick, due)

    def _run_tick(self) -> None:
        for robot in self._driven:
            robot.drive_tick()
        for _ in range(SUBSTEPS):
            self._space.step(self.tick_s / SUBSTEPS)
        for robot in [robot for robot in self._driven if robot.motion and robot.motion.is_over]:
            self.stop(robot)

    def _place_waiting(self) -> None:
        spots = _grid(*self._model.size_m)
        for robot in sorted(self._waiting, key=lambda robot: robot.name):
            free = ((x_m, y_m) for x_m, y_m in spots if self._is_free(x_m, y_m, robot.make.radius_m))
            if spot := next(free, None):
                robot.place(self._space, *spot, 0.0)
        self._waiting.clear()

    def _is_free(self, x_m: float, y_m: float, radius_m: float) -> bool:
        width_m, height_m = self._model.size_m
        inside = abs(x_m) + radius_m <= width_m / 2 and abs(y_m) + radius_m <= height_m / 2
        return inside and self._space.point_query_nearest((x_m, y_m), radius_m, pymunk.ShapeFilter()) is None


def _grid(width_m: float, height_m: float) -> list[tuple[float, float]]:
    """Return places round the centre, the inner ones first; a coarse grid, then a finer one."""
    spots = []
    for pitch_m in _PITCHES_M:
        columns, rows = (max(0, math.floor((size_m / 2 - pitch_m / 2) / pitch_m)) for size_m in (width_m, height_m))
        grid = [(x * pitch_m, y * pitch_m) for x in range(-columns, columns + 1) for y in range(-rows, rows + 1)]
        spots += sorted(grid, key=lambda spot: (math.hypot(*spot), spot))
    return spots


def _walls(body: pymunk.Body, width_m: float, height_m: float) -> list[pymunk.Shape]:
    x, y = width_m / 2 + _WALL_RADIUS_M, height_m / 2 + _WALL_RADIUS_M
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    walls = [pymunk.Segment(body, corners[i - 1], corners[i], _WALL_RADIUS_M) for i in range(4)]
    for wall in walls:
        wall.friction = 1.0
    return list(walls)


def _obstacles(body: pymunk.Body, model: WorldModel) -> list[pymunk.Shape]:
    shapes: list[pymunk.Shape] = []
    for obstacle in model.solid_obstacles:
        place = pymunk.Transform.translation(obstacle.x_m, obstacle.y_m)
        if obstacle.kind == "circle":
            shapes.append(pymunk.Circle(body, obstacle.radius_m, (obstacle.x_m, obstacle.y_m)))
        else:
            half_w, half_h = obstacle.size_m[0] / 2, obstacle.size_m[1] / 2
            corners = [(-half_w, -half_h), (half_w, -half_h), (half_w, half_h), (-half_w, half_h)]
            shapes.append(pymunk.Poly(body, corners, place.rotated(math.radians(obstacle.yaw_deg))))
    for shape in shapes:
        shape.friction = 1.0
    return shapes
