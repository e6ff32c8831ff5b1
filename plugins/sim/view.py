"""A space for looking: it shows where everything is, and is brought up to date only when somebody looks.

What drives and what touches is worked out elsewhere, so that no look can change a path.
"""

from __future__ import annotations

from typing import Protocol

import pymunk

from eal_actors.device.world import WorldModel

from .arena import Pose, add_solids, corners


class Placed(Protocol):
    """What stands somewhere."""

    @property
    def pose(self) -> Pose:
        """Where."""


class View:
    """The walls and obstacles of a world, and the shapes of its robots and boxes where they are now.

    Args:
        model: the world.

    Attributes:
        is_stale: whether something may have moved since the last look.
        names: what each shape is, for people.

    Thread: every member is for the holder of the world's lock.
    """

    def __init__(self, model: WorldModel) -> None:
        self.is_stale = False
        self._space = pymunk.Space()
        self.names = add_solids(self._space, model)
        self._shown: dict[Placed, tuple[pymunk.Body, Pose]] = {}

    def add_disc(self, thing: Placed, name: str, radius_m: float, shape_filter: pymunk.ShapeFilter) -> None:
        """Show a robot that has got its place."""
        body = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        disc = pymunk.Circle(body, radius_m)
        disc.filter = shape_filter
        self._add(thing, body, disc, name)

    def add_box(self, thing: Placed, name: str, size_m: tuple[float, float]) -> None:
        """Show a movable box."""
        body = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        self._add(thing, body, pymunk.Poly(body, corners(size_m)), name)

    @property
    def space(self) -> pymunk.Space:
        """The space, up to date."""
        if self.is_stale:
            self.is_stale = False
            for thing, (body, shown) in self._shown.items():
                if thing.pose != shown:
                    self._show(thing, body)
        return self._space

    def _add(self, thing: Placed, body: pymunk.Body, shape: pymunk.Shape, name: str) -> None:
        self.names[shape] = name
        body.position, body.angle = thing.pose[:2], thing.pose[2]
        self._space.add(body, shape)
        self._shown[thing] = body, thing.pose

    def _show(self, thing: Placed, body: pymunk.Body) -> None:
        body.position, body.angle = thing.pose[:2], thing.pose[2]
        self._space.reindex_shapes_for_body(body)
        self._shown[thing] = body, thing.pose
