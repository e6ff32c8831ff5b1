"""Reports of a simulation about its robots: the gaps around them, and their contacts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

Observe: TypeAlias = Callable[[float, str, tuple[float, float], Mapping[str, float]], float]


@dataclass(frozen=True, slots=True)
class ProximityObserver:
    """Observes the gaps between the robots of a simulated world and everything around them.

    Attributes:
        reach_m: gaps wider than this are not reported.
        observe: receives the gaps around a robot at the end of a simulation tick: the time in seconds of the fleet's
            clock, the robot's name, x and y of its centre in the world's frame (m), and the gaps in metres by name,
            from its outline to the outline of everything within reach, below 0 where they overlap. It returns a gap in
            metres: the simulation calls again at the first tick whose end may find anything nearer. Thread: the one
            that steps the world; it must not block or call robots.
    """

    reach_m: float
    observe: Observe


class Contact(NamedTuple):
    """A contact that begins.

    `time_s` is in seconds of the fleet's clock; `other` is the other robot's name, or what the robot touches.
    """

    time_s: float
    robot: str
    other: str
