"""The protocol by which a simulation reports how near its robots come to anything."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol


class ProximityObserver(Protocol):
    """Observes the gaps between the robots of a simulated world and everything around them.

    Attributes:
        reach_m: gaps wider than this are not reported.
    """

    reach_m: float

    def observe(self, time_s: float, robot: str, place_m: tuple[float, float], gaps_m: Mapping[str, float]) -> float:
        """Receive the gaps around a robot at the end of a simulation tick.

        Args:
            time_s: in seconds of the fleet's clock.
            robot: the robot's name.
            place_m: x and y of its middle, in the world's frame.
            gaps_m: from its outline to the outline of everything within reach, by name; below 0 where they overlap.

        Returns:
            A gap in metres: the simulation calls again at the first tick whose end may find anything nearer than this.

        Thread: the one that steps the world; must not block or call robots.
        """
        ...
