"""Latecomers: robots that are absent when a program begins, and that it takes in when they come."""

from __future__ import annotations

from typing import Final

from eal_actors.actors.handles import RobotHandle
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.log import get_logger


class Latecomers:
    """The robots of a fleet that are absent now, which is logged once. The fleet itself looks for them.

    Attributes:
        present: the other robots, whose resources are known.

    Thread: one at a time.
    """

    def __init__(self, fleet: Fleet) -> None:
        self._absent = list(fleet.values())
        self.present: Final = self.arrived()
        if self._absent:
            names = [robot.name for robot in self._absent]
            get_logger().warning("these robots are absent, and are taken in when they come", robots=names)

    def arrived(self) -> list[RobotHandle]:
        """Return the robots that have come since the last call. Does not block."""
        arrived = [robot for robot in self._absent if len(robot) > 0]
        self._absent = [robot for robot in self._absent if robot not in arrived]
        return arrived
