"""Worlds for the tests of simulated sensors: rooms with what stands in them, and robots put where a test wants them."""

from __future__ import annotations

from typing import Any

from eal_actors.device.world import WorldModel
from plugins.sim.models import MAKES, MakeName
from plugins.sim.robot import SimRobot
from plugins.sim.world import SimWorld
from tests.manual_clock import ManualClock


def room(width_m: float = 6.0, depth_m: float = 4.0, **parts: Any) -> WorldModel:
    """Return a room with some parts of a world file, such as obstacles and beacons."""
    return WorldModel.model_validate({"version": 1, "name": "room", "size_m": (width_m, depth_m), **parts})


class Stage:
    """A world on a clock that stands still between commands.

    Args:
        model: of the world.
        seed: the fleet's seed.
    """

    def __init__(self, model: WorldModel | None = None, seed: int = 1) -> None:
        self.clock = ManualClock()
        self.world = SimWorld(self.clock, seed, model or room())

    def put(self, x_m: float, y_m: float, yaw_rad: float = 0.0, make: MakeName = "roomba", name: str = "") -> SimRobot:
        """Put a robot into the world."""
        name = name or f"r{len(self.world.robots)}"
        return self.world.join(name, MAKES[make], noise=False, start=(x_m, y_m, yaw_rad))
