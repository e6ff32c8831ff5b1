"""A simulated arena: a walled rectangle and the things in it, as a world file describes them.

The frame of a world: the origin is the centre of the floor, x points right, y points up on the plan, z points up from
the floor, yaw turns counter-clockwise from the x axis. Lengths are metres; angles are degrees, as the `_deg` in their
names says. North is +y, east is +x.
"""

from eal_actors.device.world.loading import load_world
from eal_actors.device.world.model import (
    AnyObstacle,
    Beacon,
    BoxObstacle,
    CircleObstacle,
    Colour,
    Drop,
    Formation,
    KeepOutZone,
    Lamp,
    Lighting,
    MovableBox,
    NamedPlace,
    Partition,
    Physics,
    Poster,
    StartPose,
    Surfaces,
    SurfaceTexture,
    WorldModel,
    formation_poses,
)
from eal_actors.device.world.overhead import FloorMarker, OverheadCamera, WorldMarkers

__all__ = [
    "AnyObstacle",
    "Beacon",
    "BoxObstacle",
    "CircleObstacle",
    "Colour",
    "Drop",
    "FloorMarker",
    "Formation",
    "KeepOutZone",
    "Lamp",
    "Lighting",
    "MovableBox",
    "NamedPlace",
    "OverheadCamera",
    "Partition",
    "Physics",
    "Poster",
    "StartPose",
    "SurfaceTexture",
    "Surfaces",
    "WorldMarkers",
    "WorldModel",
    "formation_poses",
    "load_world",
]
