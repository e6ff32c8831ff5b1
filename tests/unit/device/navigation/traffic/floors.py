"""Problems for the tests of traffic planning, and judges of plans that know nothing of the planner."""

from __future__ import annotations

import itertools
import math
import random
from collections import deque
from collections.abc import Sequence

import numpy as np

from eal_actors.device.localization.pose_estimate import Point
from eal_actors.device.navigation.grid import GridOrigin, OccupancyGrid
from eal_actors.device.navigation.traffic.problem import Path, TrafficProblem
from eal_actors.device.navigation.traffic.roadmap import Traveller

Cell = tuple[int, int]


def grid_problem(free: Sequence[Cell], starts: Sequence[Cell], goals: Sequence[Cell]) -> TrafficProblem:
    """Return a problem on cells, each a neighbour of those above, below, left and right of it."""
    number_of = {cell: number for number, cell in enumerate(free)}
    neighbours = [
        [number_of[beside] for beside in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)) if beside in number_of]
        for x, y in free
    ]
    return TrafficProblem(
        neighbours, tuple(number_of[cell] for cell in starts), tuple(number_of[cell] for cell in goals)
    )


def drawn_problem(picture: str, starts: str, goals: str) -> TrafficProblem:
    """Return the problem of a picture: `#` is a wall; every other character names its cell."""
    cells = {
        character: (x, y)
        for y, line in enumerate(picture.split())
        for x, character in enumerate(line)
        if character != "#"
    }
    return grid_problem(list(cells.values()), [cells[name] for name in starts], [cells[name] for name in goals])


def random_problem(size: int, walls: float, count: int, seed: int) -> TrafficProblem:
    """Return a problem with random walls, starts and goals on the largest connected part of a square of cells."""
    chance = random.Random(seed)  # noqa: S311
    left = {(x, y) for x in range(size) for y in range(size)}
    left -= set(chance.sample(sorted(left), int(walls * size * size)))
    parts: list[list[Cell]] = []
    while left:
        part = [left.pop()]
        for x, y in part:
            found = {(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)} & left
            left -= found
            part.extend(sorted(found))
        parts.append(sorted(part))
    free = max(parts, key=len)
    return grid_problem(free, chance.sample(free, count), chance.sample(free, count))


def violations(problem: TrafficProblem, paths: Sequence[Path]) -> list[str]:
    """Return what is wrong with a plan on cells: the rules of `problem.py`, checked the slow way."""
    found = []
    places = list(itertools.zip_longest(*paths))
    full = [tuple(path[min(step, len(path) - 1)] for path in paths) for step in range(len(places))]
    if full[0] != problem.starts or full[-1] != problem.goals:
        found.append("it does not lead from the starts to the goals")
    for step, (now, after) in enumerate(itertools.pairwise(full)):
        found += [f"step {step}: {text}" for text in step_violations(problem, now, after)]
    return found


def step_violations(problem: TrafficProblem, now: Sequence[int], after: Sequence[int]) -> list[str]:
    """Return what is wrong with one step."""
    if len(set(after)) < len(after):
        return ["two are at one place"]
    if any(there not in (*problem.neighbours[here], here) for here, there in zip(now, after, strict=True)):
        return ["somebody jumps"]
    leaves = {here: there for here, there in zip(now, after, strict=True) if here != there}
    for first in leaves:
        place = leaves[first]
        while place in leaves and place != first:
            place = leaves[place]
        if place == first:
            return ["some move round in a circle"]
    return []


def is_solvable(problem: TrafficProblem) -> bool:
    """Return whether there is a plan, by visiting every configuration that can be reached."""
    known = {problem.starts}
    queue = deque([problem.starts])
    while queue:
        now = queue.popleft()
        if now == problem.goals:
            return True
        for number, here in enumerate(now):  # every plan is a sequence of single moves
            for there in problem.neighbours[here]:
                after = (*now[:number], there, *now[number + 1 :])
                if there not in now and after not in known:
                    known.add(after)
                    queue.append(after)
    return False


def room(seed: int, size_m: float = 6.0, pillars: int = 5) -> OccupancyGrid:
    """Return a square room with square pillars of 0.3 m."""
    side = round(size_m / 0.05)
    cells, chance = np.zeros((side, side), np.int8), random.Random(seed)  # noqa: S311
    for _ in range(pillars):
        x, y = (chance.randrange(10, side - 10) for _ in range(2))
        cells[y - 3 : y + 3, x - 3 : x + 3] = 100
    return OccupancyGrid(cells, 0.05, GridOrigin(-size_m / 2, -size_m / 2))


def random_travellers(grid: OccupancyGrid, count: int, seed: int, margin_m: float = 0.1) -> list[Traveller]:
    """Return robots of different size that start anywhere, if need be nearly touching, and go anywhere."""
    chance = random.Random(seed)  # noqa: S311
    radii_m = [chance.choice((0.12, 0.15, 0.18)) for _ in range(count)]
    starts = _places(grid, count, 0.37, chance)
    goals = _places(grid, count, 2 * max(radii_m) + margin_m, chance)
    return [Traveller(f"r{number}", starts[number], goals[number], radii_m[number]) for number in range(count)]


def _places(grid: OccupancyGrid, count: int, apart_m: float, chance: random.Random) -> list[Point]:
    inflated, found = grid.inflated(0.18), list[Point]()
    half_m = grid.cells.shape[0] * grid.resolution_m / 2
    while len(found) < count:
        point = chance.uniform(-half_m, half_m), chance.uniform(-half_m, half_m)
        if inflated.is_free(*point) and all(math.dist(point, other) >= apart_m for other in found):
            found.append(point)
    return found
