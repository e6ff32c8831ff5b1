"""A simulated arena: a walled rectangle and what stands in it, as a world file describes it.

The frame of a world: the origin is the middle of the floor, x points right, y points up on the plan, z points up from
the floor, yaw turns counter-clockwise from the x axis. Lengths are metres; angles are degrees, as the `_deg` in their
names says. North is +y, east is +x.
"""

from eal_actors.device.world.formation import Formation, formation_poses
from eal_actors.device.world.loading import load_world
from eal_actors.device.world.model import WorldModel
from eal_actors.device.world.parts import (
    AnyObstacle,
    Beacon,
    BoxObstacle,
    CircleObstacle,
    Colour,
    Drop,
    Light,
    Lighting,
    MovableBox,
    Partition,
    Physics,
    Poster,
    StartPose,
    Surfaces,
    Texture,
)

__all__ = [
    "AnyObstacle",
    "Beacon",
    "BoxObstacle",
    "CircleObstacle",
    "Colour",
    "Drop",
    "Formation",
    "Light",
    "Lighting",
    "MovableBox",
    "Partition",
    "Physics",
    "Poster",
    "StartPose",
    "Surfaces",
    "Texture",
    "WorldModel",
    "formation_poses",
    "load_world",
]
