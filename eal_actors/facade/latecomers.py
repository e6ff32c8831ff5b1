"""Latecomers: robots that are absent when a program begins, and that it takes in when they come."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
        self.present: Final = self._arrived()
        if self._absent:
            names = [robot.name for robot in self._absent]
            get_logger().warning("these robots are absent, and are taken in when they come", robots=names)

    def take_in(self, add: Callable[[Sequence[RobotHandle]], None]) -> None:
        """Add the robots that have come since the last call. One that cannot be added is logged and left out.

        Args:
            add: adds robots to the program; what it raises stops no other robot.
        """
        for robot in self._arrived():
            try:
                add([robot])
            except Exception as error:  # noqa: BLE001  # the caller's thread may watch over every other robot
                get_logger(robot=robot.name).error("it is left out", error=f"{type(error).__name__}: {error}")

    def _arrived(self) -> list[RobotHandle]:
        arrived = [robot for robot in self._absent if len(robot) > 0]
        self._absent = [robot for robot in self._absent if robot not in arrived]
        return arrived
