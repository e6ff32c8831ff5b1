"""Proximity events of a simulation, recorded from its steps: start, end, smallest gap and position."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

TOUCH_M: Final = 0.001
"""A smaller gap counts as contact: physics engines leave a small gap or overlap between bodies in contact."""

_LOOK_M: Final = 1.0  # radius of the search for the nearest object, unless the margin is larger


@dataclass(frozen=True, slots=True)
class ClosestApproach:
    """The smallest distance between a robot and another object.

    Attributes:
        other: the other robot's name, or the name of an object of the world.
        gap_m: distance of their outlines; negative if they overlap.
        time_s: time of the fleet's clock, in seconds.
        place_m: x and y of the robot's centre at that time.
    """

    other: str
    gap_m: float
    time_s: float
    place_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class ProximityEvent:
    """A period during which an object was closer to a robot than the margin.

    Attributes:
        robot: its name; of two robots, the one that was observed first.
        nearest: the closest approach of the period, or the first contact if they touched.
        start_s: start of the period by the fleet's clock, in seconds.
        end_s: last observation of the period.
    """

    robot: str
    nearest: ClosestApproach
    start_s: float
    end_s: float

    @property
    def is_hit(self) -> bool:
        """Whether they touched."""
        return self.nearest.gap_m <= TOUCH_M


class ProximityRecorder:
    """Recorder of the gaps that a `ProximityObserver` reports from a simulated world.

    Attributes:
        reach_m: gaps up to this one are observed.
        robots: first observed position of each robot, by name.
        nearest: closest approach by robot; a robot with nothing within reach has no entry.

    Thread: not thread-safe; the world calls it under its lock.
    """

    def __init__(self, margin_m: float) -> None:
        self.margin_m = margin_m
        self.reach_m = max(margin_m, _LOOK_M)
        self.robots: dict[str, tuple[float, float]] = {}
        self.nearest: dict[str, ClosestApproach] = {}
        self._open: dict[tuple[str, str], ProximityEvent] = {}
        self._closed: list[ProximityEvent] = []

    def observe(self, time_s: float, robot: str, place_m: tuple[float, float], gaps_m: Mapping[str, float]) -> float:
        """Record the gaps round a robot; return the gap up to which the world must observe it next."""
        place_m = (float(place_m[0]), float(place_m[1]))
        self.robots.setdefault(robot, place_m)
        for other, gap_m in gaps_m.items():
            seen = ClosestApproach(other, float(gap_m), time_s, place_m)
            if seen.gap_m < self._nearest_m(robot):
                self.nearest[robot] = seen
            if seen.gap_m < self.margin_m:
                self._update_event(robot, seen)
        for one, other in [key for key in self._open if robot in key]:
            partner = other if robot == one else one
            if gaps_m.get(partner, math.inf) >= self.margin_m:
                self._closed.append(self._open.pop((one, other)))
        return max(self.margin_m, self._nearest_m(robot))

    @property
    def events(self) -> tuple[ProximityEvent, ...]:
        """All proximity events, ordered by start."""
        return tuple(sorted((*self._closed, *self._open.values()), key=lambda event: event.start_s))

    def _nearest_m(self, robot: str) -> float:
        nearest = self.nearest.get(robot)
        return self.reach_m if nearest is None else nearest.gap_m

    def _update_event(self, robot: str, seen: ClosestApproach) -> None:
        reverse = (seen.other, robot)  # a pair of robots has one event, whichever of them is observed
        key = reverse if reverse in self._open else (robot, seen.other)
        known = self._open.get(key)
        if known is None:
            self._open[key] = ProximityEvent(robot, seen, seen.time_s, seen.time_s)
            return
        is_nearer = robot == known.robot and not known.is_hit and seen.gap_m < known.nearest.gap_m
        self._open[key] = ProximityEvent(known.robot, seen if is_nearer else known.nearest, known.start_s, seen.time_s)
