from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eal_actors.device.navigation.traffic.lacam import NoPlanError, PlanWorkError, search
from eal_actors.device.navigation.traffic.planner import REFINE_WORK_EACH
from eal_actors.device.navigation.traffic.problem import cost_of
from eal_actors.device.navigation.traffic.refining import refine
from tests.unit.device.navigation.traffic.floors import (
    Cell,
    drawn_problem,
    grid_problem,
    is_solvable,
    random_problem,
    violations,
)

WORK = 400_000


@pytest.mark.parametrize(("count", "most"), [(50, 1.15), (200, 1.4)])
def test_plans_on_32_x_32_cells_are_valid_and_short(count: int, most: float) -> None:
    problem = random_problem(32, 0.1, count, seed=0)
    paths = refine(problem, search(problem, 0, WORK), 0, REFINE_WORK_EACH * count)
    assert violations(problem, paths) == []
    assert cost_of(paths) <= most * problem.least_cost


def test_two_robots_cannot_swap_in_a_corridor() -> None:
    with pytest.raises(NoPlanError):
        search(drawn_problem("abc", "ac", "ca"), 0, WORK)


def test_two_robots_swap_by_a_niche() -> None:
    problem = drawn_problem("abcd #e##", "ad", "da")
    assert violations(problem, search(problem, 0, WORK)) == []


def test_a_full_ring_cannot_turn() -> None:
    """Nobody could go first: a robot enters a place when the one before has left it."""
    with pytest.raises(NoPlanError):
        search(drawn_problem("ab cd", "abdc", "bdca"), 0, WORK)


def test_a_ring_with_a_gap_turns() -> None:
    problem = drawn_problem("ab cd", "abd", "bdc")
    assert violations(problem, search(problem, 0, WORK)) == []


def test_the_bound_of_work_ends_the_search() -> None:
    with pytest.raises(PlanWorkError):
        search(random_problem(32, 0.1, 200, 0), 0, 300)


def test_a_plan_depends_on_its_seed_alone() -> None:
    problem = random_problem(16, 0.1, 40, 1)
    plans = [refine(problem, search(problem, 5, WORK), 5, 10_000) for _ in range(2)]
    assert plans[0] == plans[1]


@st.composite
def _small_floors(draw: st.DrawFn) -> tuple[list[Cell], list[Cell], list[Cell]]:
    wide, high = draw(st.integers(1, 4)), draw(st.integers(1, 3))
    cells = [(x, y) for x in range(wide) for y in range(high)]
    free = draw(st.lists(st.sampled_from(cells), min_size=1, max_size=10, unique=True))
    count = draw(st.integers(1, min(4, len(free))))
    starts, goals = (draw(st.permutations(free))[:count] for _ in range(2))
    return free, starts, goals


@settings(max_examples=40, deadline=None)
@given(_small_floors(), st.integers(0, 3))
def test_it_finds_a_plan_exactly_where_there_is_one(
    floor: tuple[list[Cell], list[Cell], list[Cell]], seed: int
) -> None:
    problem = grid_problem(*floor)
    try:
        paths = search(problem, seed, WORK)
    except NoPlanError:
        assert not is_solvable(problem)
    else:
        assert violations(problem, paths) == []
        assert violations(problem, refine(problem, paths, seed, 2_000)) == []
