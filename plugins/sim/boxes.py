"""Movable boxes: bodies of the physics engine with friction on the floor.

Thread: every member is for the holder of the world's lock.
"""

from __future__ import annotations

import math
from typing import Final

import pymunk

from eal_actors.device.world import WorldModel

from .arena import Pose2D, corners

_BOX_FRICTION: Final = 0.3
_GRAVITY_M_S2: Final = 9.81
_REST_M_S: Final = 1e-4


class SimBox:
    """A movable box.

    Args:
        number: index among the world's boxes, from 0.

    Attributes:
        name: from the world file.
        shape: its shape in the space.
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
        pivot.max_bias = gear.max_bias = 0.0  # the joints are floor friction and must not pull it back
        pivot.max_force = model.friction * model.mass_kg * _GRAVITY_M_S2
        gear.max_force = pivot.max_force * math.hypot(*model.size_m) / 4
        space.add(body, shape, pivot, gear)
        self.shape = shape
        self._body = body

    @property
    def pose(self) -> Pose2D:
        """Its centre's x and y in metres and its yaw in radians, unwrapped, in the world's frame."""
        return *self._body.position, self._body.angle

    @property
    def is_moving(self) -> bool:
        """Whether it slides or turns."""
        reach_m = math.hypot(*self.model.size_m) / 2
        return bool(self._body.velocity.length + abs(self._body.angular_velocity) * reach_m > _REST_M_S)

    def rest(self) -> None:
        """Set its velocity to exactly 0."""
        self._body.velocity, self._body.angular_velocity = (0.0, 0.0), 0.0
