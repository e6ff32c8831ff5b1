"""Order of the robots' movements: phases without close approaches, whatever the robots' speeds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from eal_actors.device.navigation.assigning import assign_places
from eal_actors.device.navigation.traffic.lattice import Point
from eal_actors.kernel.errors import ArgumentError

_ROUNDING_M: Final = 1e-9


class Phases(NamedTuple):
    """A plan of movements.

    Attributes:
        steps: for each phase, the number of each robot's place at its end; -1 is the robot's start.
        place_of: number of each robot's final place.
    """

    steps: list[list[int]]
    place_of: list[int]


def plan_phases(starts: Sequence[Point], places: Sequence[Point], clearance_m: float) -> Phases:
    """Plan the phases.

    In a phase several robots move at once, each straight to a place. Each keeps the clearance from the standing robots
    and from the complete paths of the other moving ones, so that speeds and start times do not matter. A phase ends
    when its last robot has arrived.

    Robots whose places block no other path move first. If a robot still blocks a path, the places are assigned again
    from the current positions: the blocking robot moves on to the place behind it, and the other one takes its place.

    Args:
        starts: positions of the robots.
        places: target positions, one for each robot.
        clearance_m: smallest distance between the centres of two robots.

    Raises:
        ArgumentError: the numbers of places and robots differ, two starts or two places are closer than the clearance,
            or every order leaves a path blocked.
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
            place_of = _reassign(at, places, goals, clearance_m, len(waiting))
            continue
        for robot in going:
            at[robot], place_at[robot] = goals[robot], place_of[robot]
        phases.append(list(place_at))
    return Phases(phases, place_of)


def _next_phase(waiting: Sequence[int], at: Sequence[Point], goals: Sequence[Point], clearance_m: float) -> list[int]:
    """Return the robots that can move now; none if all block each other."""
    paths = {robot: (at[robot], goals[robot]) for robot in waiting}
    free = [robot for robot in waiting if _is_clear(paths[robot], _without(at, robot), clearance_m)]
    harmless = [
        robot
        for robot in free
        if all(_is_clear(path, [goals[robot]], clearance_m) for other, path in paths.items() if other != robot)
    ]
    going: list[int] = []
    for robot in harmless or free[:1]:
        if all(path_distance_m(paths[robot], paths[other]) >= clearance_m for other in going):
            going.append(robot)
    return going


def _reassign(
    at: Sequence[Point], places: Sequence[Point], goals: Sequence[Point], clearance_m: float, stuck: int
) -> list[int]:
    """Assign the places again from the current positions; the sum of squared distances falls, so planning terminates.

    Raises:
        ArgumentError: the sum does not fall.
    """
    place_of = assign_places(at, places)
    new_m2 = sum(math.dist(point, places[number]) ** 2 for point, number in zip(at, place_of, strict=True))
    if new_m2 >= sum(math.dist(point, goal) ** 2 for point, goal in zip(at, goals, strict=True)) - _ROUNDING_M:
        raise ArgumentError(
            f"{stuck} of {len(at)} robots block each other: increase the spacing, "
            f"or use a smaller margin than {clearance_m:g} m between centres"
        )
    return place_of


def _check_apart(points: Sequence[Point], what: str, verb: str, clearance_m: float) -> None:
    for number, point in enumerate(points):
        for other in points[:number]:
            if math.dist(point, other) < clearance_m - _ROUNDING_M:
                raise ArgumentError(
                    f"two {what} {verb} {math.dist(point, other):.2f} m apart; the margin needs {clearance_m:.2f} m "
                    "between centres"
                )


def _without(points: Sequence[Point], robot: int) -> list[Point]:
    return [point for other, point in enumerate(points) if other != robot]


def _is_clear(path: tuple[Point, Point], standing: Iterable[Point], clearance_m: float) -> bool:
    return all(distance_to_path_m(point, path) >= clearance_m - _ROUNDING_M for point in standing)


def distance_to_path_m(point: Point, path: tuple[Point, Point]) -> float:
    """Return the distance from a point to the nearest point of a straight path."""
    (x_m, y_m), (to_x_m, to_y_m) = path
    dx_m, dy_m = to_x_m - x_m, to_y_m - y_m
    square_m2 = dx_m * dx_m + dy_m * dy_m
    along = ((point[0] - x_m) * dx_m + (point[1] - y_m) * dy_m) / square_m2 if square_m2 else 0.0
    along = min(max(along, 0.0), 1.0)
    return math.dist(point, (x_m + along * dx_m, y_m + along * dy_m))


def path_distance_m(path: tuple[Point, Point], other: tuple[Point, Point]) -> float:
    """Return the smallest distance between two straight paths; 0 if they cross."""
    if _side(path, other[0]) * _side(path, other[1]) < 0 and _side(other, path[0]) * _side(other, path[1]) < 0:
        return 0.0
    return min(
        *(distance_to_path_m(point, other) for point in path),
        *(distance_to_path_m(point, path) for point in other),
    )


def _side(path: tuple[Point, Point], point: Point) -> float:
    """Return a positive number for a point left of a path, a negative one for a point right of it."""
    (x_m, y_m), (to_x_m, to_y_m) = path
    return (to_x_m - x_m) * (point[1] - y_m) - (to_y_m - y_m) * (point[0] - x_m)
