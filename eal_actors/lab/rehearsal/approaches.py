"""Makes approaches of what a simulation tells step by step: from when to when, how near at the nearest, and where."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

TOUCH_M: Final = 0.001
"""What is no farther apart touches: engines let things that touch be a little apart, or overlap a little."""

_LOOK_M: Final = 1.0
"""How far round a robot the nearest thing is looked for, where the margin is not larger."""


@dataclass(frozen=True, slots=True)
class Nearest:
    """The nearest that anything came to a robot.

    Attributes:
        other: what; a robot's name, or what a thing of the world is called.
        gap_m: between their outlines; below 0 where they overlap.
        time_s: when, in seconds of the fleet's clock.
        place_m: x and y of the robot's middle then.
    """

    other: str
    gap_m: float
    time_s: float
    place_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Approach:
    """A time during which something was nearer to a robot than the margin.

    Attributes:
        robot: its name; of two robots, the one that was seen first.
        nearest: what, and the nearest that it came; if they touched, when they did so first.
        start_s: when it came nearer than the margin, in seconds of the fleet's clock.
        end_s: when that was last seen.
    """

    robot: str
    nearest: Nearest
    start_s: float
    end_s: float

    @property
    def is_hit(self) -> bool:
        """Whether they touched."""
        return self.nearest.gap_m <= TOUCH_M


class Approaches:
    """Watches the robots of a simulated world; see `eal_actors.device.proximity.ProximityObserver`.

    Args:
        margin_m: what comes nearer than this is an approach.

    Attributes:
        reach_m: what is farther away is not told.
        robots: where each robot was first seen, by name.
        nearest: by robot, the nearest that anything came to it; nothing within reach has no entry.

    Thread: one at a time; the world's lock sees to that.
    """

    def __init__(self, margin_m: float) -> None:
        self.margin_m = margin_m
        self.reach_m = max(margin_m, _LOOK_M)
        self.robots: dict[str, tuple[float, float]] = {}
        self.nearest: dict[str, Nearest] = {}
        self._open: dict[tuple[str, str], Approach] = {}
        self._over: list[Approach] = []

    def observe(self, time_s: float, robot: str, place_m: tuple[float, float], gaps_m: Mapping[str, float]) -> float:
        """Receive the gaps around a robot; see `ProximityObserver.observe`."""
        place_m = (float(place_m[0]), float(place_m[1]))
        self.robots.setdefault(robot, place_m)
        for other, gap_m in gaps_m.items():
            seen = Nearest(other, float(gap_m), time_s, place_m)
            if seen.gap_m < self._nearest_m(robot):
                self.nearest[robot] = seen
            if seen.gap_m < self.margin_m:
                self._note(robot, seen)
        for key in list(self._open):
            partner = _partner(key, robot)
            if partner is not None and gaps_m.get(partner, math.inf) >= self.margin_m:
                self._over.append(self._open.pop(key))
        return max(self.margin_m, self._nearest_m(robot))

    @property
    def found(self) -> tuple[Approach, ...]:
        """All approaches, in the order in which they began."""
        return tuple(sorted((*self._over, *self._open.values()), key=lambda approach: approach.start_s))

    def _nearest_m(self, robot: str) -> float:
        nearest = self.nearest.get(robot)
        return self.reach_m if nearest is None else nearest.gap_m

    def _note(self, robot: str, seen: Nearest) -> None:
        key = self._key(robot, seen.other)
        known = self._open.get(key)
        if known is None:
            self._open[key] = Approach(robot, seen, seen.time_s, seen.time_s)
            return
        is_nearer = robot == known.robot and not known.is_hit and seen.gap_m < known.nearest.gap_m
        self._open[key] = Approach(known.robot, seen if is_nearer else known.nearest, known.start_s, seen.time_s)

    def _key(self, robot: str, other: str) -> tuple[str, str]:
        """Return one key for two robots, whoever of them is seen."""
        return (other, robot) if (other, robot) in self._open else (robot, other)


def _partner(key: tuple[str, str], robot: str) -> str | None:
    """Return what a robot is near to in an open approach, or None if it has no part in it."""
    one, other = key
    return other if robot == one else one if robot == other else None
