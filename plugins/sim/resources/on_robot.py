"""What every resource of a simulated robot has: its world and its robot."""

from __future__ import annotations

from eal_actors.plugin import Resource

from ..robot import SimRobot
from ..world import SimWorld


class OnRobot(Resource):
    """A resource of one robot of the world.

    Args:
        world: the world that the robot is in.
        robot: the robot.
    """

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        self._world = world
        self._robot = robot
