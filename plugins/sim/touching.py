"""Physics for what touches: robots that push something, and boxes that slide.

A robot with nothing in its way needs no physics engine: its path is known exactly. Only robots that come upon something
get a body in the engine, for as long as they push. So free robots cost little, their paths are exact and do not depend
on what others do, and those that touch can be stepped finely.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final, TypeAlias

import pymunk

from eal_actors.device.world import WorldModel

from .arena import Pose, add_solids, corners
from .robot import SimRobot

_Part: TypeAlias = pymunk.Body | pymunk.Shape | pymunk.Constraint

_SUBSTEPS: Final = 10
"""Steps of the engine in a tick: a robot that runs into a wall sinks in by its travel in one of them."""

_SLOP_M: Final = 0.0005  # how far shapes may overlap before they are pushed apart
_ROBOT_FRICTION: Final = 0.3
_BOX_FRICTION: Final = 0.3
_GRAVITY_M_S2: Final = 9.81
_REST_M_S: Final = 1e-4
_FREE_M: Final = 1e-9  # a robot that the engine moved as far as predicted, but for rounding, touched nothing


class SimBox:
    """A movable box.

    Args:
        world: the world.
        number: which of the world's boxes it is, from 0.
        space: the physics space that it is in.

    Attributes:
        name: as the world file says.
        model: what the world file says of it.

    Thread: every member is for the holder of the world's lock.
    """

    def __init__(self, world: WorldModel, number: int, space: pymunk.Space) -> None:
        self.model = model = world.boxes[number]
        self.name = model.name
        body = pymunk.Body(model.mass_kg, pymunk.moment_for_box(model.mass_kg, model.size_m))
        body.position, body.angle = (model.x_m, model.y_m), math.radians(model.yaw_deg)
        shape = pymunk.Poly(body, corners(model.size_m))
        shape.friction = _BOX_FRICTION
        pivot = pymunk.PivotJoint(space.static_body, body, (0.0, 0.0), (0.0, 0.0))
        gear = pymunk.GearJoint(space.static_body, body, 0.0, 1.0)
        pivot.max_bias = gear.max_bias = 0.0  # the floor holds it by friction and pulls it nowhere
        pivot.max_force = model.friction * model.mass_kg * _GRAVITY_M_S2
        gear.max_force = pivot.max_force * math.hypot(*model.size_m) / 4
        space.add(body, shape, pivot, gear)
        self._body = body

    @property
    def pose(self) -> Pose:
        """Its middle's x and y in metres and its yaw in radians, unwrapped, in the world's frame."""
        return *self._body.position, self._body.angle

    @property
    def is_moving(self) -> bool:
        """Whether it slides or turns."""
        reach_m = math.hypot(*self.model.size_m) / 2
        return bool(self._body.velocity.length + abs(self._body.angular_velocity) * reach_m > _REST_M_S)

    def rest(self) -> None:
        """Take the last trace of speed from it."""
        self._body.velocity, self._body.angular_velocity = (0.0, 0.0), 0.0


class _Rig:
    """A robot's body in the engine, dragged by a control body through two joints of limited force.

    The control body has the velocity that the wheels give; the joints pass it on to the robot with no more force than
    the robot has, so that a wall holds it.
    """

    def __init__(self, robot: SimRobot, space: pymunk.Space) -> None:
        make = robot.make
        moment = pymunk.moment_for_circle(make.mass_kg, 0.0, make.radius_m)
        self.body = pymunk.Body(make.mass_kg, moment)
        self._control = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        for body in (self.body, self._control):
            body.position, body.angle = robot.pose[:2], robot.pose[2]
        pivot = pymunk.PivotJoint(self._control, self.body, (0.0, 0.0), (0.0, 0.0))
        gear = pymunk.GearJoint(self._control, self.body, 0.0, 1.0)
        pivot.max_bias = gear.max_bias = 0.0  # the wheels do not make up for what a wall took
        pivot.max_force = make.push_n
        gear.max_force = make.push_n * make.track_m / 2
        self.parts: list[_Part] = [self._control, self.body, _disc(robot, self.body), pivot, gear]
        space.add(*self.parts)
        self.command(robot)
        self.body.velocity, self.body.angular_velocity = self._control.velocity, self._control.angular_velocity

    def command(self, robot: SimRobot) -> None:
        """Give the control body the velocity that leads to where the wheels turn the robot in the tick."""
        (x_m, y_m, yaw_rad), (next_x_m, next_y_m, next_yaw_rad) = robot.pose, robot.next_pose
        self._control.velocity = (next_x_m - x_m) / robot.tick_s, (next_y_m - y_m) / robot.tick_s
        self._control.angular_velocity = (next_yaw_rad - yaw_rad) / robot.tick_s

    def pose_after(self, robot: SimRobot) -> Pose:
        """Return where the robot got; the predicted pose itself if nothing was in its way."""
        pose = (*self.body.position, self.body.angle)
        free = all(abs(one - other) < _FREE_M for one, other in zip(pose, robot.next_pose, strict=True))
        return robot.next_pose if free else pose


class Touching:
    """The engine: what stands, what slides, and the robots that push.

    Args:
        model: the world.
        tick_s: length of a physics tick.

    Attributes:
        boxes: the movable boxes.
        space: the engine's space, to be queried only by what decides who pushes.

    Thread: every member is for the holder of the world's lock.
    """

    def __init__(self, model: WorldModel, tick_s: float) -> None:
        self._tick_s = tick_s
        self.space = pymunk.Space()
        self.space.collision_slop = _SLOP_M
        add_solids(self.space, model)
        self.boxes = tuple(SimBox(model, number, self.space) for number in range(len(model.boxes)))
        self._standing: dict[SimRobot, list[_Part]] = {}
        self._pushing: dict[SimRobot, _Rig] = {}

    @property
    def is_awake(self) -> bool:
        """Whether something in it may move in the next tick."""
        return bool(self._pushing) or any(box.is_moving for box in self.boxes)

    def settle(self, robot: SimRobot) -> None:
        """Let a robot stand: nothing moves it, not even by a rounding error."""
        self.release(robot)
        body = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        body.position = robot.pose[:2]
        parts: list[_Part] = [body, _disc(robot, body)]
        self.space.add(*parts)
        self._standing[robot] = parts

    def release(self, robot: SimRobot) -> None:
        """Take a robot out of the engine: it drives freely."""
        if parts := self._standing.pop(robot, None):
            self.space.remove(*parts)
        if rig := self._pushing.pop(robot, None):
            self.space.remove(*rig.parts)

    def run_tick(self, pushing: Iterable[SimRobot]) -> dict[SimRobot, Pose]:
        """Step the engine by one tick; return where the robots that may push something get."""
        now_pushing = dict.fromkeys(pushing)
        for robot in [robot for robot in self._pushing if robot not in now_pushing]:
            self.release(robot)
        for robot in now_pushing:
            if rig := self._pushing.get(robot):
                rig.command(robot)
            else:
                self._pushing[robot] = _Rig(robot, self.space)
        if not self.is_awake:
            return {}
        for _ in range(_SUBSTEPS):
            self.space.step(self._tick_s / _SUBSTEPS)
        for box in self.boxes:
            if not box.is_moving:
                box.rest()
        return {robot: rig.pose_after(robot) for robot, rig in self._pushing.items()}


def _disc(robot: SimRobot, body: pymunk.Body) -> pymunk.Circle:
    disc = pymunk.Circle(body, robot.make.radius_m)
    disc.filter, disc.friction = robot.filter, _ROBOT_FRICTION
    return disc
