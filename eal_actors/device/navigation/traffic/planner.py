"""Plans the traffic of a fleet: from robots and their goals to moves that wait for each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from eal_actors.device.localization.pose_estimate import Point
from eal_actors.device.navigation.grid import OccupancyGrid
from eal_actors.device.navigation.traffic.action_graph import action_graph
from eal_actors.device.navigation.traffic.alone import way_alone
from eal_actors.device.navigation.traffic.errors import TrafficError
from eal_actors.device.navigation.traffic.lacam import NoPlanError, SearchError, search
from eal_actors.device.navigation.traffic.problem import FAR, TrafficProblem
from eal_actors.device.navigation.traffic.refining import refine
from eal_actors.device.navigation.traffic.roadmap import RoadmapBuilder, StandingDisc, Traveller, point_text

MARGIN_M: Final = 0.1
"""Distance that hulls keep from each other: robots stray from their ways by a few centimetres."""
MAX_TRAVELLERS: Final = 500
SEARCH_WORK: Final = 400_000
"""Travellers that the search may place in all: some seconds of processor time."""
REFINE_WORK_EACH: Final = 750
"""Places and steps for each traveller that the refinement may look at: about 1 s of processor time for 200."""


@dataclass(frozen=True, slots=True)
class TrafficMove:
    """A straight move of one robot.

    `waits_for` are robots, and how many of their moves must be over before this one begins.
    """

    to: Point
    waits_for: tuple[tuple[str, int], ...]


@dataclass(frozen=True, slots=True)
class TrafficPlan:
    """The moves of all robots.

    Attributes:
        moves: the moves of each robot in their order; none for a robot that is at its goal and may stay.
        clearance_m: distance that the centres of two robots keep on their ways.
    """

    moves: dict[str, tuple[TrafficMove, ...]]
    clearance_m: float


def plan_traffic(
    grid: OccupancyGrid, travellers: Sequence[Traveller], standing: Sequence[StandingDisc] = (), *, seed: int = 0
) -> TrafficPlan:
    """Plan the moves of all robots to their goals.

    The plan depends on the arguments alone, and its work is bounded. `grid` is not inflated. `standing` are robots that
    stay, and obstacles that are on no map. `seed` is that of choices between equal paths. Raises TrafficError if a
    start or goal is not free, two goals are too near to each other, a goal cannot be reached, there is no plan, or none
    was found within the bound of work. The message names the robots.
    """
    if len(travellers) > MAX_TRAVELLERS:
        raise TrafficError(f"traffic is planned for at most {MAX_TRAVELLERS} robots at once, not {len(travellers)}")
    if not travellers:
        return TrafficPlan({}, 0.0)
    if len(travellers) == 1 and (alone := _plan_alone(grid, travellers[0], standing)):
        return alone
    roadmap = RoadmapBuilder(grid, travellers, standing, MARGIN_M).build()
    problem = roadmap.problem
    _check_reachable(problem, travellers)
    try:
        paths = search(problem, seed, SEARCH_WORK)
    except SearchError as error:
        late = [travellers[number] for number in error.late]
        raise TrafficError(
            f"{_names(travellers)} cannot all reach their goals; {_names(late)} can make way for the others: "
            f"{_why_no_plan(error, roadmap.clearance_m)}",
            robots=[traveller.name for traveller in late],
        ) from None
    if problem.anywhere:
        problem = replace(problem, goals=tuple(path[-1] for path in paths), anywhere=frozenset())
    paths = refine(problem, paths, seed, REFINE_WORK_EACH * len(travellers))
    names = [traveller.name for traveller in travellers]
    points = [(float(x_m), float(y_m)) for x_m, y_m in roadmap.points]
    moves = {
        name: tuple(
            TrafficMove(points[move.there], tuple((names[other], count) for other, count in move.waits_for))
            for move in own
        )
        for name, own in zip(names, action_graph(problem, paths), strict=True)
    }
    return TrafficPlan(moves, roadmap.clearance_m)


def _plan_alone(grid: OccupancyGrid, traveller: Traveller, standing: Sequence[StandingDisc]) -> TrafficPlan | None:
    if (way := way_alone(grid, traveller, standing, MARGIN_M)) is None:
        return None
    moves = tuple(TrafficMove(place, ()) for place in way)
    return TrafficPlan({traveller.name: moves}, 2 * traveller.radius_m + MARGIN_M)


def _check_reachable(problem: TrafficProblem, travellers: Sequence[Traveller]) -> None:
    for traveller, table, start in zip(travellers, problem.distances, problem.starts, strict=True):
        if table[start] >= FAR:
            raise TrafficError(
                f"{traveller.name} cannot reach its goal {point_text(traveller.goal)} from "
                f"{point_text(traveller.start)}: no way is free that is wide enough",
                robots=[traveller.name],
            )


def _why_no_plan(error: SearchError, clearance_m: float) -> str:
    if isinstance(error, NoPlanError):
        return f"no order of their moves leads there, with {clearance_m:.2f} m between their centres"
    return (
        "no plan was found within the bound of work; it may be that there is none. Send fewer robots at once, or give "
        "them more room"
    )


def _names(travellers: Sequence[Traveller]) -> str:
    names = [traveller.name for traveller in travellers]
    return ", ".join(names) if len(names) <= 8 else f"{', '.join(names[:8])} and {len(names) - 8} more"
