"""Who goes when: phases in which nobody comes near anybody, whatever the speeds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.choreography.assigning import Point, assign_places

_ROUNDING_M: Final = 1e-9


class Phases(NamedTuple):
    """Who goes when.

    Attributes:
        steps: for each phase, the number of the place where each robot is in the end of it; -1 is where it first stood.
        place_of: the number of each robot's place in the end.
    """

    steps: list[list[int]]
    place_of: list[int]


def plan_phases(starts: Sequence[Point], places: Sequence[Point], clearance_m: float) -> Phases:
    """Plan who goes when.

    In a phase several robots go at once, each straight to a place. Each keeps the clearance from whoever stands
    meanwhile, and from the whole ways of the others, so that it does not matter who is fast or slow, or when each
    begins. A phase is over when its last robot has arrived.

    Robots go early whose places bar nobody's way later. Where somebody is in the way all the same, the places are given
    anew: he goes on to the place behind him, and leaves his own to the one who comes.

    Args:
        starts: where the robots stand.
        places: where they are wanted; as many.
        clearance_m: from the middle of a robot to the middle of any other.

    Raises:
        ArgumentError: there are more or fewer places than robots, two starts or two places are nearer than the
            clearance, or no order lets everybody through.
    """
    _check_apart(starts, "robots", "stand", clearance_m)
    _check_apart(places, "places", "are", clearance_m)
    place_of = assign_places(starts, places)
    at, place_at = list(starts), [-1] * len(starts)
    phases: list[list[int]] = []
    while waiting := [
        robot for robot, point in enumerate(at) if math.dist(point, places[place_of[robot]]) > _ROUNDING_M
    ]:
        goals = [places[number] for number in place_of]
        going = _next_phase(waiting, at, goals, clearance_m)
        if not going:
            place_of = _given_anew(at, places, goals, clearance_m, len(waiting))
            continue
        for robot in going:
            at[robot], place_at[robot] = goals[robot], place_of[robot]
        phases.append(list(place_at))
    return Phases(phases, place_of)


def _next_phase(waiting: Sequence[int], at: Sequence[Point], goals: Sequence[Point], clearance_m: float) -> list[int]:
    """Return the robots that can go at once; none if everybody is in somebody's way."""
    ways = {robot: (at[robot], goals[robot]) for robot in waiting}
    free = [robot for robot in waiting if _is_clear(ways[robot], _without(at, robot), clearance_m)]
    harmless = [
        robot
        for robot in free
        if all(_is_clear(way, [goals[robot]], clearance_m) for other, way in ways.items() if other != robot)
    ]
    going: list[int] = []
    for robot in harmless or free[:1]:
        if all(ways_apart_m(ways[robot], ways[other]) >= clearance_m for other in going):
            going.append(robot)
    return going


def _given_anew(
    at: Sequence[Point], places: Sequence[Point], goals: Sequence[Point], clearance_m: float, stuck: int
) -> list[int]:
    """Return who gets which place from where they stand now: a smaller sum of squared ways, so it comes to an end.

    Raises:
        ArgumentError: the sum does not become smaller.
    """
    place_of = assign_places(at, places)
    new_m2 = sum(math.dist(point, places[number]) ** 2 for point, number in zip(at, place_of, strict=True))
    if new_m2 >= sum(math.dist(point, goal) ** 2 for point, goal in zip(at, goals, strict=True)) - _ROUNDING_M:
        raise ArgumentError(
            f"{stuck} of {len(at)} robots stand in each other's way; a greater spacing, "
            f"or a smaller margin than {clearance_m:g} m from middle to middle, lets them by"
        )
    return place_of


def _check_apart(points: Sequence[Point], what: str, verb: str, clearance_m: float) -> None:
    for number, point in enumerate(points):
        for other in points[:number]:
            if math.dist(point, other) < clearance_m - _ROUNDING_M:
                raise ArgumentError(
                    f"two {what} {verb} {math.dist(point, other):.2f} m apart, and {clearance_m:.2f} m "
                    "from middle to middle are needed to keep the margin"
                )


def _without(points: Sequence[Point], robot: int) -> list[Point]:
    return [point for other, point in enumerate(points) if other != robot]


def _is_clear(way: tuple[Point, Point], standing: Iterable[Point], clearance_m: float) -> bool:
    return all(distance_to_way_m(point, way) >= clearance_m - _ROUNDING_M for point in standing)


def distance_to_way_m(point: Point, way: tuple[Point, Point]) -> float:
    """Return the distance from a point to the nearest point of a straight way."""
    (x_m, y_m), (to_x_m, to_y_m) = way
    dx_m, dy_m = to_x_m - x_m, to_y_m - y_m
    square_m2 = dx_m * dx_m + dy_m * dy_m
    along = ((point[0] - x_m) * dx_m + (point[1] - y_m) * dy_m) / square_m2 if square_m2 else 0.0
    along = min(max(along, 0.0), 1.0)
    return math.dist(point, (x_m + along * dx_m, y_m + along * dy_m))


def ways_apart_m(way: tuple[Point, Point], other: tuple[Point, Point]) -> float:
    """Return how near two straight ways come to each other; 0 where they cross."""
    if _sides(way, other[0]) * _sides(way, other[1]) < 0 and _sides(other, way[0]) * _sides(other, way[1]) < 0:
        return 0.0
    return min(
        *(distance_to_way_m(point, other) for point in way),
        *(distance_to_way_m(point, way) for point in other),
    )


def _sides(way: tuple[Point, Point], point: Point) -> float:
    """Return over 0 left of a way, under 0 right of it."""
    (x_m, y_m), (to_x_m, to_y_m) = way
    return (to_x_m - x_m) * (point[1] - y_m) - (to_y_m - y_m) * (point[0] - x_m)
