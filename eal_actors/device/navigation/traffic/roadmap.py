"""Roadmap: a lattice of places on the floor, and each robot's own start and goal between them.

The lattice's pitch is the *clearance*: the distance that the centres of two robots keep, so that their hulls keep the
margin. Two edges of the lattice without a common end are a pitch or more apart. So robots on moves whose blocks do not
meet never come nearer to each other than the clearance, wherever they are on their ways. Starts, goals and bridges are
anywhere: their moves block every place that is nearer than the clearance to a point of the way.

Distances of ends suffice for that: where two ways are nearest to each other is an end of one of them, or they cross. Of
two that cross, an end of one is at most half its length from the other, and no edge is longer than 1.5 pitches.

Robots may start nearer to each other than the clearance. Then a way that leads away from the other one is open, for on
two such ways they only part.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from eal_actors.device.localization.pose_estimate import Point
from eal_actors.device.navigation.grid import OccupancyGrid
from eal_actors.device.navigation.traffic.bridges import find_bridges, way_out
from eal_actors.device.navigation.traffic.errors import TrafficError
from eal_actors.device.navigation.traffic.lattice import Edge, lay_lattice
from eal_actors.device.navigation.traffic.problem import TrafficProblem
from eal_actors.device.navigation.traffic.segments import Floats, distances_to_ways_m

_SAME_PLACE_M: Final = 0.01  # a start so near a place of the lattice, or the goal, is that place
_EXACT_M: Final = 1e-3  # a goal so near a place of the lattice is that place
_LONGEST_OWN: Final = 1.5  # pitches
_MOST_OWN: Final = 6
_START_SHARES: Final = (1.0, 0.75, 0.5)
"""Shares of its radius with which a robot's start may be free: it may stand at a wall, and poses err."""
_GOAL_SHARE: Final = 0.5
"""The share of the margin that a goal must be off what stands: only the robot that comes there strays."""
_ROUNDING_M: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Traveller:
    """A robot that is to drive.

    Attributes:
        start: x and y in m, in the map frame.
        goal: x and y in m.
        radius_m: of its hull.
        makes_way: whether it may end anywhere; its goal is its start.
    """

    name: str
    start: Point
    goal: Point
    radius_m: float
    makes_way: bool = False


@dataclass(frozen=True, slots=True)
class StandingDisc:
    """A robot that does not travel, or an obstacle that is on no map.

    `at` is x and y in m, in the map frame; `radius_m` is that of its hull.
    """

    name: str
    at: Point
    radius_m: float


@dataclass(frozen=True)
class Roadmap:
    """A planning problem with the positions of its places.

    `points` are x and y of each place in m, shape (n, 2); `clearance_m` is the distance that the centres of two robots
    keep.
    """

    points: Floats
    problem: TrafficProblem
    clearance_m: float


class RoadmapBuilder:
    """Builds the roadmap for some robots.

    The grid is not inflated, there is at least one traveller, and hulls keep `margin_m` from each other.
    """

    def __init__(
        self, grid: OccupancyGrid, travellers: Sequence[Traveller], standing: Sequence[StandingDisc], margin_m: float
    ) -> None:
        self._grid = grid
        self._travellers = travellers
        self._standing = standing
        self._margin_m = margin_m
        self._radius_m = max(traveller.radius_m for traveller in travellers)
        self._clearance_m = 2 * self._radius_m + margin_m
        self._points: list[Point] = []
        self._lattice_edges: list[Edge] = []
        self._bridge_edges: list[Edge] = []
        self._own_edges: list[tuple[int, Edge]] = []  # with the number of the traveller
        self._inflated: dict[float, OccupancyGrid] = {}

    def build(self) -> Roadmap:
        """Return the roadmap.

        Raises:
            TrafficError: the map is too large, a start or goal is not free, or two goals are too near to each other.
        """
        numbers = range(len(self._travellers))
        bound = [number for number in numbers if not self._travellers[number].makes_way]
        for place, number in enumerate(bound):
            self._check_goal(number, bound[:place])
        self._add_lattice()
        nodes = np.array(self._points, np.float64).reshape(-1, 2)
        self._add_bridges()
        on_lattice = self._starts_on_lattice(nodes)
        starts = [on_lattice[n] if n in on_lattice else self._add_start(n, nodes) for n in numbers]
        goals = [self._add_goal(number, nodes, starts[number]) for number in numbers]
        points = np.array(self._points, np.float64).reshape(-1, 2)
        neighbours: list[list[int]] = [[] for _ in points]
        for here, there in (*self._lattice_edges, *self._bridge_edges):
            neighbours[here].append(there)
            neighbours[there].append(here)
        own: dict[int, dict[int, list[int]]] = {}
        for number, (here, there) in self._own_edges:
            own.setdefault(number, {}).setdefault(here, []).append(there)
            own[number].setdefault(there, []).append(here)
        blocks = self._blocks(points, len(nodes), {start for start in starts if start >= len(nodes)})
        anywhere = frozenset(numbers) - frozenset(bound)
        problem = TrafficProblem(neighbours, tuple(starts), tuple(goals), blocks, own, len(nodes), anywhere)
        return Roadmap(points, problem, self._clearance_m)

    # Checks.

    def _check_goal(self, number: int, before: Sequence[int]) -> None:
        traveller = self._travellers[number]
        goal = f"the goal of {traveller.name}, {point_text(traveller.goal)},"
        if not self._inflated_by(traveller.radius_m).is_free(*traveller.goal):
            raise TrafficError(f"{goal} {self._why_not_free(traveller)}", robots=[traveller.name])
        for thing in self._standing:
            if math.dist(traveller.goal, thing.at) < self._clearance_of(thing, traveller.radius_m, _GOAL_SHARE):
                raise TrafficError(
                    f"{goal} is occupied: {thing.name} is at {point_text(thing.at)}", robots=[traveller.name]
                )
        for other in (self._travellers[earlier] for earlier in before):
            apart_m = math.dist(traveller.goal, other.goal)
            if apart_m < self._clearance_m - _ROUNDING_M:
                raise TrafficError(
                    f"{goal} is {apart_m:.2f} m from the goal of {other.name}; these robots need "
                    f"{self._clearance_m:.2f} m between their centres",
                    robots=[other.name, traveller.name],
                )

    def _why_not_free(self, traveller: Traveller) -> str:
        if self._grid.cell_at(*traveller.goal) is None:
            return "is outside the map"
        if not self._grid.is_free(*traveller.goal):
            return "is inside an obstacle, or where the map is unknown"
        return f"is nearer to an obstacle than the robot's radius of {traveller.radius_m:.2f} m"

    def _inflated_by(self, radius_m: float) -> OccupancyGrid:
        if radius_m not in self._inflated:
            self._inflated[radius_m] = self._grid.inflated(radius_m)
        return self._inflated[radius_m]

    def _clearance_of(self, thing: StandingDisc, radius_m: float, share: float = 1.0) -> float:
        return thing.radius_m + radius_m + share * self._margin_m - _ROUNDING_M

    # Places and ways.

    def _add_lattice(self) -> None:
        points, edges = lay_lattice(self._inflated_by(self._radius_m), self._clearance_m)
        if not points:
            return
        places, ends = np.array(points), np.array(edges, np.intp).reshape(-1, 2)
        place_is_open, edge_is_open = np.ones(len(points), np.bool_), np.ones(len(edges), np.bool_)
        for thing in self._standing:
            keep_m = self._clearance_of(thing, self._radius_m)
            place_is_open &= distances_to_ways_m(thing.at, places, places) >= keep_m
            edge_is_open &= distances_to_ways_m(thing.at, places[ends[:, 0]], places[ends[:, 1]]) >= keep_m
        number_of = np.cumsum(place_is_open) - 1
        self._points = [point for point, is_open in zip(points, place_is_open, strict=True) if is_open]
        self._lattice_edges = [(int(here), int(there)) for here, there in number_of[ends[edge_is_open]].tolist()]

    def _add_bridges(self) -> None:
        inflated = self._inflated_by(self._radius_m)
        for first, between, last in find_bridges(inflated, self._points, self._lattice_edges, self._clearance_m):
            way = [first, *range(len(self._points), len(self._points) + len(between)), last]
            points = [self._points[first], *between, self._points[last]]
            if all(self._is_clear(ends, self._radius_m) for ends in itertools.pairwise(points)):
                self._points += between
                self._bridge_edges += itertools.pairwise(way)

    def _starts_on_lattice(self, nodes: Floats) -> dict[int, int]:
        """Return the place of the lattice of each traveller that starts so near it that it counts as there.

        That place keeps the clearance from all other starts. Otherwise neither robot could leave: only a start off the
        lattice has ways that lead away from others.
        """
        if not len(nodes):
            return {}
        at = np.array([traveller.start for traveller in self._travellers])
        offsets_m = np.array([np.hypot(*(nodes - start).T) for start in at])
        found = {
            int(number): int(offsets_m[number].argmin())
            for number in np.flatnonzero(offsets_m.min(axis=1) < _SAME_PLACE_M)
        }
        while True:
            where = np.array([nodes[found[number]] if number in found else start for number, start in enumerate(at)])
            apart_m = np.hypot(*(where[:, None] - where).T)
            np.fill_diagonal(apart_m, math.inf)
            too_near = [number for number in found if apart_m[number].min() < self._clearance_m - _ROUNDING_M]
            if not too_near:
                return found
            for number in too_near:
                del found[number]

    def _add_start(self, number: int, nodes: Floats) -> int:
        traveller = self._travellers[number]
        for share in _START_SHARES:
            grid = self._inflated_by(share * traveller.radius_m)
            if grid.is_free(*traveller.start):
                return self._add_own(number, nodes, traveller.start, grid)
        raise TrafficError(
            f"{traveller.name} is at {point_text(traveller.start)}, which is inside an obstacle or outside the map; "
            "correct its pose or the map",
            robots=[traveller.name],
        )

    def _add_goal(self, number: int, nodes: Floats, start: int) -> int:
        traveller = self._travellers[number]
        if math.dist(traveller.start, traveller.goal) < _SAME_PLACE_M:
            return start
        offsets_m = np.hypot(*(nodes - traveller.goal).T) if len(nodes) else np.empty(0)
        if offsets_m.min(initial=math.inf) < _EXACT_M:
            return int(offsets_m.argmin())
        grid = self._inflated_by(traveller.radius_m)
        goal = self._add_own(number, nodes, traveller.goal, grid)
        ends = self._points[start], self._points[goal]
        if math.dist(*ends) <= _LONGEST_OWN * self._clearance_m and self._is_open(ends, traveller, grid):
            self._own_edges.append((number, (start, goal)))
        return goal

    def _add_own(self, number: int, nodes: Floats, point: Point, grid: OccupancyGrid) -> int:
        """Add a place of one traveller, and its ways to the nearest places of the lattice."""
        place = len(self._points)
        self._points.append(point)
        offsets_m = np.hypot(*(nodes - point).T) if len(nodes) else np.empty(0)
        ways = 0
        for node in np.argsort(offsets_m, kind="stable").tolist():
            if ways == _MOST_OWN or offsets_m[node] > _LONGEST_OWN * self._clearance_m:
                break
            if self._is_open((point, self._points[node]), self._travellers[number], grid):
                self._own_edges.append((number, (place, node)))
                ways += 1
        if not ways:
            self._add_way_out(number, place, [(x_m, y_m) for x_m, y_m in nodes.tolist()], grid)
        return place

    def _add_way_out(self, number: int, place: int, nodes: Sequence[Point], grid: OccupancyGrid) -> None:
        """Lead one traveller out of a niche, or into it, where the lattice is not in sight."""
        radius_m = self._travellers[number].radius_m
        discs = [(thing.at, self._clearance_of(thing, radius_m)) for thing in self._standing]
        if (found := way_out(grid, self._points[place], nodes, discs, self._clearance_m)) is not None:
            between, node = found
            way = [place, *range(len(self._points), len(self._points) + len(between)), node]
            self._points += between
            self._own_edges += ((number, edge) for edge in itertools.pairwise(way))

    def _is_open(self, ends: tuple[Point, Point], traveller: Traveller, grid: OccupancyGrid) -> bool:
        return self._is_clear(ends, traveller.radius_m, leads_away=True) and grid.is_line_free(*ends)

    def _is_clear(self, ends: tuple[Point, Point], radius_m: float, *, leads_away: bool = False) -> bool:
        """Return whether a way keeps off what stands; if its first end is near that, it may lead away from there."""
        for thing in self._standing:
            keep_m = self._clearance_of(thing, radius_m)
            if leads_away:
                keep_m = min(keep_m, math.dist(ends[0], thing.at) - _ROUNDING_M)
            if distances_to_ways_m(thing.at, *ends) < keep_m:
                return False
        return True

    def _blocks(self, points: Floats, lattice: int, own_starts: set[int]) -> dict[Edge, frozenset[int]]:
        """Return the blocks of the moves that exclude others from more than their two ends."""
        near_m = self._clearance_m - _ROUNDING_M
        found: dict[Edge, set[int]] = {}
        ends = np.array(self._lattice_edges, np.intp).reshape(-1, 2)
        heres, theres = points[ends[:, 0]], points[ends[:, 1]]
        for place in range(lattice, len(points)):
            for number in np.flatnonzero(distances_to_ways_m(points[place], heres, theres) < near_m).tolist():
                edge = self._lattice_edges[number]
                found.setdefault(edge, set(edge)).add(place)
        for edge in (*self._bridge_edges, *(edge for _, edge in self._own_edges)):
            here, there = edge
            near = np.flatnonzero(distances_to_ways_m(points, points[here], points[there]) < near_m).tolist()
            if here in own_starts:
                away = points[there] - points[here]
                near = [
                    place
                    for place in near
                    if place not in own_starts or place == here or away @ (points[place] - points[here]) > 0
                ]
            found.setdefault(edge, set(edge)).update(near)
        both = {}
        for (here, there), block in found.items():
            both[here, there] = both[there, here] = frozenset(block)
        return both


def point_text(point: Point) -> str:
    """Return a point for messages."""
    return f"({point[0]:.2f}, {point[1]:.2f})"
