"""Reports of a simulation about its robots: the gaps around them, and their contacts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

from eal_actors.device.localization.pose_estimate import Point


class ProximityObserver(Protocol):
    """Observes the gaps between the robots of a simulated world and everything around them.

    Attributes:
        reach_m: gaps wider than this are not reported.
    """

    reach_m: float

    def observe(self, time_s: float, robot: str, place_m: Point, gaps_m: Mapping[str, float], /) -> float:
        """Observe the gaps around a robot at the end of a simulation tick.

        The time is in seconds of the fleet's clock, the place the robot's centre in the world's frame. The gaps are in
        metres by name, from its outline to the outline of everything within reach, below 0 where they overlap. Return a
        gap in metres: the simulation calls again at the first tick whose end may find anything nearer. Thread: the one
        that steps the world; it must not block or call robots.
        """
        ...


class Contact(NamedTuple):
    """A contact that begins.

    `time_s` is in seconds of the fleet's clock; `other` is the other robot's name, or what the robot touches.
    """

    time_s: float
    robot: str
    other: str
