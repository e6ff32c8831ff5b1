"""The scene of a world, which its cameras share, and what moves in it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from operator import attrgetter
from typing import Final
from weakref import WeakKeyDictionary

from eal_actors.device.world import WorldModel

from ..arena import Pose2D
from ..robot import SimRobot
from ..world import SimWorld
from .movers import BoxAt, Mover, RobotAppearance, RobotAt
from .scene import Scene

_scenes: Final[WeakKeyDictionary[SimWorld, Scene]] = WeakKeyDictionary()
_latest: Final[list[tuple[WorldModel, Scene]]] = []
"""The latest scene and its model: a proof or a sweep runs one world many times, and baking textures takes a second."""
_scenes_lock: Final = threading.Lock()


def scene_of(world: SimWorld) -> Scene:
    """Return the scene of a world; create it on first use. Thread: any."""
    with _scenes_lock:
        scene = _scenes.get(world)
        if scene is None:
            known = (scene for model, scene in _latest if model == world.model)
            scene = _scenes[world] = next(known, None) or Scene(world.model)
            _latest[:] = [(world.model, scene)]
        return scene


def movers_of(
    world: SimWorld, viewer: SimRobot | None = None, pose_of: Callable[[SimRobot], Pose2D] = attrgetter("pose")
) -> list[Mover]:
    """Return the boxes and the robots at their poses, without the viewer. Thread: holds the world's `lock`."""
    movers: list[Mover] = [BoxAt(number, *box.pose) for number, box in enumerate(world.boxes)]
    for robot in world.robots:
        if robot is not viewer:
            make = robot.make
            look = RobotAppearance(make.radius_m, make.height_m, make.body_colour, make.camera_height_m)
            movers.append(RobotAt(look, *pose_of(robot), robot.turret_yaw_rad))
    return movers
