from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eal_actors.device.navigation.grid import GridOrigin, OccupancyGrid
from eal_actors.device.navigation.traffic.errors import TrafficError
from eal_actors.device.navigation.traffic.planner import MARGIN_M, TrafficPlan, plan_traffic
from eal_actors.device.navigation.traffic.roadmap import StandingDisc, Traveller
from eal_actors.device.navigation.traffic.segments import distances_to_ways_m
from tests.unit.device.navigation.traffic.execution import PlanExecution
from tests.unit.device.navigation.traffic.floors import random_travellers, room


def carry_out(plan: TrafficPlan, travellers: Sequence[Traveller], grid: OccupancyGrid, seed: int) -> None:
    """Carry a plan out with random speeds and stops, and judge hulls in each small step."""
    radii_m = {traveller.name: traveller.radius_m for traveller in travellers}
    execution = PlanExecution(plan, {traveller.name: traveller.start for traveller in travellers}, seed)
    pairs = list(itertools.combinations(radii_m, 2))
    begun_m = {pair: math.dist(*(execution.at[name] for name in pair)) for pair in pairs}
    walls = {radius_m: grid.inflated(radius_m) for radius_m in radii_m.values()}
    while execution.step():
        for a, b in pairs:
            apart_m = math.dist(execution.at[a], execution.at[b])
            least_m = min(plan.clearance_m, begun_m[a, b]) - 0.011  # a start is that of a place 1 cm from it
            assert apart_m >= least_m, f"{a} and {b} are {apart_m:.3f} m apart"
            assert apart_m > radii_m[a] + radii_m[b]
        for name, at in execution.at.items():
            assert walls[radii_m[name]].is_free(*at), f"{name} is in a wall"
    for traveller in travellers:
        assert execution.done[traveller.name] == len(plan.moves[traveller.name]), "a deadlock"
        assert math.dist(execution.at[traveller.name], traveller.goal) < 0.0101


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 14))
def test_robots_of_any_speed_that_stop_anywhere_never_touch(seed: int, count: int) -> None:
    grid = room(seed)
    travellers = random_travellers(grid, count, seed)
    carry_out(plan_traffic(grid, travellers, seed=seed), travellers, grid, seed)


def _travellers(*ways: tuple[float, float, float, float], radius_m: float = 0.15) -> list[Traveller]:
    return [Traveller(f"r{number}", way[:2], way[2:], radius_m) for number, way in enumerate(ways)]


def test_two_robots_swap_places() -> None:
    grid = room(0, 3.0, 0)
    travellers = _travellers((-0.5, 0.03, 0.5, 0.03), (0.5, 0.03, -0.5, 0.03))
    carry_out(plan_traffic(grid, travellers), travellers, grid, 1)


@pytest.mark.parametrize("off_m", [0.0, 0.004, 0.008])
def test_neighbours_that_stand_nearly_on_the_lattice_leave(off_m: float) -> None:
    """One starts 3 cm off a place of the lattice, the other near the next place, which is within the clearance."""
    grid = room(0, 6.0, 0)
    travellers = _travellers((1.22, 1.246, -1.65, 2.0), (1.25, 0.75 - off_m, -1.65, 0.0), radius_m=0.2)
    carry_out(plan_traffic(grid, travellers), travellers, grid, 1)


def test_robots_pass_a_door_that_is_off_the_lattice() -> None:
    """The door is 0.45 m wide, the robots 0.3 m, and the lattice is where most of its places are free."""
    for left in (20, 23, 26):
        cells = np.zeros((60, 60), np.int8)
        cells[:, 29:31] = 100
        cells[left : left + 9, 29:31] = 0
        grid = OccupancyGrid(cells, 0.05, GridOrigin(0.0, 0.0))
        travellers = _travellers((0.6, 0.6, 2.4, 0.6), (2.4, 2.4, 0.6, 2.4))
        carry_out(plan_traffic(grid, travellers), travellers, grid, left)


def test_a_robot_drives_round_what_stands() -> None:
    grid = room(0, 3.0, 0)
    travellers = _travellers((-1.0, 0.0, 1.0, 0.0))
    plan = plan_traffic(grid, travellers, [StandingDisc("person", (0.0, 0.1), 0.25)])
    at = [(-1.0, 0.0), *(move.to for move in plan.moves["r0"])]
    for (x0, y0), (x1, y1) in itertools.pairwise(at):
        for share in np.linspace(0, 1, 20):
            assert math.dist((x0 + share * (x1 - x0), y0 + share * (y1 - y0)), (0.0, 0.1)) > 0.15 + 0.25


def test_a_robot_by_itself_drives_straight_to_its_goal() -> None:
    grid = room(0, 6.0, 0)
    (traveller,) = _travellers((-2.0, -1.3, 2.2, 1.9))
    places = [traveller.start, *(move.to for move in plan_traffic(grid, [traveller]).moves["r0"])]
    assert places[-1] == pytest.approx(traveller.goal)
    for place in places[1:-1]:
        assert math.dist(traveller.start, place) + math.dist(place, traveller.goal) == pytest.approx(
            math.dist(traveller.start, traveller.goal)
        )
    pitch_m = 2 * traveller.radius_m + MARGIN_M
    assert max(itertools.starmap(math.dist, itertools.pairwise(places))) <= pitch_m + 1e-9


def test_a_robot_by_itself_keeps_off_what_stands_near_the_shortest_way() -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        grid, standing = (
            room(0, 6.0, 0),
            [StandingDisc("box", (float(x_m), float(y_m)), 0.1) for x_m, y_m in rng.uniform(-1.5, 1.5, (6, 2))],
        )
        (traveller,) = _travellers((-2.5, -2.5, 2.5, 2.5))
        places = [traveller.start, *(move.to for move in plan_traffic(grid, [traveller], standing).moves["r0"])]
        ways = np.array(places)
        for thing in standing:
            nearest_m = distances_to_ways_m(thing.at, ways[:-1], ways[1:]).min()
            assert nearest_m >= thing.radius_m + traveller.radius_m + 0.99 * MARGIN_M, (seed, thing)


def test_a_robot_at_its_goal_makes_way_and_returns() -> None:
    cells = np.zeros((40, 80), np.int8)
    cells[:14] = cells[24:] = 100  # a corridor of 0.5 m
    cells[24:38, 30:42] = 0  # with a niche
    grid = OccupancyGrid(cells, 0.05, GridOrigin(0.0, 0.0))
    travellers = _travellers((0.5, 0.95, 3.5, 0.95), (2.5, 0.95, 2.5, 0.95))
    plan = plan_traffic(grid, travellers)
    assert plan.moves["r1"]
    carry_out(plan, travellers, grid, 3)


def test_starts_and_goals_in_niches_off_the_lattice() -> None:
    """No straight way leads out of the niches, which are as deep as three places of the lattice."""
    cells = np.full((80, 80), 100, np.int8)
    cells[:, 30:50] = 0  # a corridor of 1 m, x from 1.5 to 2.5 m
    for row in (11, 52):
        cells[row : row + 9, 6:30] = 0
        cells[row : row + 25, 6:15] = 0
    grid = OccupancyGrid(cells, 0.05, GridOrigin(0.0, 0.0))
    ends = (0.525, 1.5), (0.525, 3.5)
    travellers = _travellers((*ends[0], *ends[1]), (*ends[1], *ends[0]))
    carry_out(plan_traffic(grid, travellers), travellers, grid, 1)
    with pytest.raises(TrafficError, match="r0 cannot reach its goal") as caught:
        plan_traffic(grid, travellers[:1], [StandingDisc("box", (0.525, 2.75), 0.1)])
    assert caught.value.robots == ("r0",)


def test_robots_that_only_make_way_end_anywhere() -> None:
    """In a corridor with a bay at its end, one robot must leave the place that is another one's goal."""
    cells = np.zeros((40, 80), np.int8)
    cells[:14] = cells[24:] = 100  # 0.5 m wide
    cells[24:38, 62:72] = 0
    grid = OccupancyGrid(cells, 0.05, GridOrigin(0.0, 0.0))
    sent, bystander = _travellers((0.5, 0.95, 2.5, 0.95), (2.5, 0.95, 2.5, 0.95))
    with pytest.raises(TrafficError, match="is occupied: r1 is at"):
        plan_traffic(grid, [sent], [StandingDisc("r1", bystander.start, bystander.radius_m)])
    plan = plan_traffic(grid, [sent, replace(bystander, makes_way=True)])
    away = plan.moves["r1"][-1].to
    carry_out(plan, [sent, replace(bystander, goal=away)], grid, 2)
    assert plan_traffic(grid, [replace(sent, goal=(1.2, 0.95)), replace(bystander, makes_way=True)]).moves["r1"] == ()


def test_those_that_prevent_a_plan_are_named() -> None:
    """Two robots cannot swap in the corridor; the third one, in a room of its own, is not concerned."""
    cells = np.full((60, 60), 100, np.int8)
    cells[5:15] = cells[35:45, 15:45] = 0
    grid = OccupancyGrid(cells, 0.05, GridOrigin(0.0, 0.0))
    travellers = _travellers((0.5, 0.5, 2.5, 0.5), (2.5, 0.5, 0.5, 0.5), (1.0, 2.0, 2.0, 2.0))
    with pytest.raises(TrafficError, match="r0, r1, r2 cannot all reach their goals; r0, r1 can make way") as caught:
        plan_traffic(grid, travellers)
    assert set(caught.value.robots) == {"r0", "r1"}
    way_out = [
        replace(one, goal=one.start, makes_way=True) if one.name in caught.value.robots else one for one in travellers
    ]
    assert plan_traffic(grid, way_out).moves["r2"]


def test_robots_that_cannot_pass_each_other_are_named() -> None:
    cells = np.zeros((10, 60), np.int8)  # 0.5 m wide
    grid = OccupancyGrid(cells, 0.05, GridOrigin(0.0, 0.0))
    with pytest.raises(TrafficError, match="r0, r1 cannot all reach their goals"):
        plan_traffic(grid, _travellers((0.5, 0.25, 2.5, 0.25), (2.5, 0.25, 0.5, 0.25)))


@pytest.mark.parametrize(
    ("goals", "message", "robots"),
    [
        ([(0.5, 0.5), (0.5, 0.6)], "0.10 m from the goal of r0", ("r0", "r1")),
        ([(0.5, 0.5), (0.9, 0.0)], "of r1, .0.90, 0.00., is nearer to an obstacle", ("r1",)),
        ([(0.5, 0.5), (1.2, 0.0)], "is inside an obstacle", ("r1",)),
        ([(0.5, 0.5), (5.0, 0.0)], "is outside the map", ("r1",)),
        ([(2.0, 0.0), (0.5, 0.0)], "r0 cannot reach its goal", ("r0",)),
        ([(-0.5, -0.8), (0.5, 0.0)], "is occupied: box is at", ("r0",)),
    ],
)
def test_goals_that_cannot_be_reached_are_named(
    goals: list[tuple[float, float]], message: str, robots: tuple[str, ...]
) -> None:
    cells = np.zeros((60, 80), np.int8)
    cells[:, 50:58] = 100  # x from 1.0 to 1.4 m
    grid = OccupancyGrid(cells, 0.05, GridOrigin(-1.5, -1.5))
    travellers = _travellers((-0.5, 0.0, *goals[0]), (0.0, 0.6, *goals[1]))
    with pytest.raises(TrafficError, match=message) as caught:
        plan_traffic(grid, travellers, [StandingDisc("box", (-0.5, -0.7), 0.1)])
    assert set(caught.value.robots) == set(robots)
    assert caught.value.copy().robots == caught.value.robots


def test_a_start_inside_an_obstacle_is_named() -> None:
    grid = room(0, 3.0, 0)
    with pytest.raises(TrafficError, match=r"r0 is at .9.00, 0.00., which is inside an obstacle or outside the map"):
        plan_traffic(grid, _travellers((9.0, 0.0, 0.5, 0.0)))


def test_more_robots_than_can_be_planned_are_refused() -> None:
    with pytest.raises(TrafficError, match="at most 500 robots"):
        plan_traffic(room(0), _travellers(*[(0.0, 0.0, 1.0, 1.0)] * 501))


def test_a_map_that_is_too_large_is_refused() -> None:
    grid = OccupancyGrid(np.zeros((1200, 1200), np.int8), 0.1, GridOrigin(0.0, 0.0))
    with pytest.raises(TrafficError, match=r"the map is too large .*; drive each robot by base\.go_to"):
        plan_traffic(grid, _travellers((1.0, 1.0, 2.0, 2.0), (5.0, 1.0, 6.0, 2.0)))


def test_nobody_has_nothing_to_do() -> None:
    assert plan_traffic(room(0), []).moves == {}
