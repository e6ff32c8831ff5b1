"""Which of the robots that drive come upon something in a tick."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from .models import MAKES
from .robot import SimRobot
from .touching import Touching

if TYPE_CHECKING:
    from numpy.typing import NDArray

_LOOK_M: Final = 1.0  # how far round a robot is searched
_RECEDES_M: Final = 1e-9  # what comes no nearer than this is not run into
_ROWS: Final = 32  # of a table of distances, worked out at once: more would not fit a processor's cache
FASTEST_M_S: Final = 1.2 * max(make.max_speed_m_s for make in MAKES.values())  # wheel errors and pushed boxes included


class Nearness:
    """Finds the robots that would overlap something at the end of a tick, and come closer to it by then.

    After a search, a robot is left alone until it or anything else could have covered the distance found.

    Args:
        touching: where all that stands, slides or pushes is.
        tick_s: length of a physics tick.

    Thread: every member is for the holder of the world's lock.
    """

    def __init__(self, touching: Touching, tick_s: float) -> None:
        self._touching = touching
        self._tick_m = FASTEST_M_S * tick_s

    def pushing(
        self, driven: Sequence[SimRobot], tick: int, free: Sequence[SimRobot] = (), ahead: int = 0
    ) -> list[SimRobot]:
        """Return those of some driven robots that may touch something in this tick, in their order.

        A robot that is near one of those is among them: it may be held up where it was not expected to be.

        Args:
            driven: the robots, with their poses predicted.
            tick: the tick of the world.
            free: other driven robots, which touch nothing.
            ahead: by how many ticks those have gone on already.
        """
        due = [number for number, robot in enumerate(driven) if robot.clear_until_tick < tick]
        if not due:
            return []
        everybody = (*driven, *free)
        ends = np.array([robot.next_pose[:2] for robot in everybody])
        widest_m = max(robot.make.radius_m for robot in everybody) + ahead * self._tick_m
        between_m = _nearest_m(ends, due)
        near = []
        for number, middle_m in zip(due, between_m, strict=True):
            robot = driven[number]
            gap_m = min(middle_m - widest_m, self._nearest_other_m(robot)) - robot.make.radius_m
            if gap_m > 2 * self._tick_m:
                robot.clear_until_tick = tick + int(gap_m / (2 * self._tick_m)) - 1
            else:
                near.append(robot)
        return self._among(near) if near else []

    def _nearest_other_m(self, robot: SimRobot) -> float:
        """Return how far the predicted middle is from anything but free robots."""
        hit = self._touching.space.point_query_nearest(robot.next_pose[:2], _LOOK_M, robot.filter)
        return float(hit.distance) if hit else _LOOK_M

    def _among(self, near: Sequence[SimRobot]) -> list[SimRobot]:
        """Return those that run into something or each other, and whatever is close to one of them."""
        neighbours = _neighbours(near, 2 * self._tick_m)
        found = [
            number
            for number, robot in enumerate(near)
            if self._runs_into(robot) or any(_meet(robot, near[other]) for other in neighbours[number])
        ]
        pushing = set(found)
        while found:
            found = [other for number in found for other in neighbours[number] if other not in pushing]
            pushing.update(found)
        return [near[number] for number in sorted(pushing)]

    def _runs_into(self, robot: SimRobot) -> bool:
        """Whether a robot comes upon something else than a free robot."""
        radius_m = robot.make.radius_m
        for hit in self._touching.space.point_query(robot.next_pose[:2], radius_m + self._tick_m, robot.filter):
            body = hit.shape.body
            if body is None or body.velocity != (0.0, 0.0):  # it pushes, or slides
                return True
            now_m = hit.shape.point_query(robot.pose[:2]).distance
            if hit.distance < radius_m and hit.distance < now_m - _RECEDES_M:
                return True
        return False


def _neighbours(robots: Sequence[SimRobot], gap_m: float) -> list[list[int]]:
    """Return for each robot the numbers of those that are no farther from it than a gap."""
    places = np.array([robot.pose[:2] for robot in robots])
    radii_m = np.array([robot.make.radius_m for robot in robots])
    dx, dy = (places[:, axis, np.newaxis] - places[:, axis] for axis in range(2))
    reach_m = radii_m[:, np.newaxis] + radii_m + gap_m
    close = dx * dx + dy * dy < reach_m * reach_m
    np.fill_diagonal(close, val=False)
    found: list[list[int]] = [[] for _ in robots]
    for one, other in zip(*(numbers.tolist() for numbers in np.nonzero(close)), strict=True):
        found[one].append(other)
    return found


def _nearest_m(ends: NDArray[np.float64], due: list[int]) -> list[float]:
    """Return how far the ends of the due rows are from the nearest other end."""
    xs, ys = np.ascontiguousarray(ends.T)
    nearest: list[float] = []
    for start in range(0, len(due), _ROWS):
        rows = due[start : start + _ROWS]
        square = np.subtract.outer(xs[rows], xs)
        square *= square
        dy = np.subtract.outer(ys[rows], ys)
        dy *= dy
        square += dy
        square[np.arange(len(rows)), rows] = np.inf
        nearest += np.sqrt(square.min(axis=1)).tolist()
    return nearest


def _meet(one: SimRobot, other: SimRobot) -> bool:
    reach_m = one.make.radius_m + other.make.radius_m
    end_m = math.dist(one.next_pose[:2], other.next_pose[:2])
    return end_m < reach_m and end_m < math.dist(one.pose[:2], other.pose[:2]) - _RECEDES_M
