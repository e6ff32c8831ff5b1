"""Assignments: the least sum, whatever the order."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eal_actors.device.navigation.assigning import assign_places, least_assignment
from eal_actors.kernel.errors import ArgumentError

COSTS = st.integers(1, 6).flatmap(
    lambda size: st.lists(
        st.lists(st.integers(0, 50).map(float), min_size=size, max_size=size), min_size=size, max_size=size
    )
)
POINTS = st.tuples(st.integers(-100, 100).map(float), st.integers(-100, 100).map(float))
PAIRS = st.lists(st.tuples(POINTS, POINTS), min_size=1, max_size=12)


@given(COSTS)
def test_the_sum_is_the_least_of_all(costs: list[list[float]]) -> None:
    found = least_assignment(costs)
    size = len(costs)
    least = min(sum(costs[row][order[row]] for row in range(size)) for order in itertools.permutations(range(size)))
    assert sorted(found) == list(range(size))
    assert sum(costs[row][column] for row, column in enumerate(found)) == least


@given(PAIRS)
def test_no_two_robots_change_sides(pairs: list[tuple[tuple[float, float], tuple[float, float]]]) -> None:
    starts, places = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    goals = [places[number] for number in assign_places(starts, places)]
    for one, other in itertools.combinations(range(len(pairs)), 2):
        start = [a - b for a, b in zip(starts[one], starts[other], strict=True)]
        goal = [a - b for a, b in zip(goals[one], goals[other], strict=True)]
        assert start[0] * goal[0] + start[1] * goal[1] >= 0


def test_robots_that_stand_in_a_row_move_up_rather_than_pass_each_other() -> None:
    assert assign_places([(0, 0), (1, 0), (2, 0)], [(1, 0), (2, 0), (3, 0)]) == [0, 1, 2]


def test_as_many_places_as_robots() -> None:
    with pytest.raises(ArgumentError, match="2 robots need as many places, not 1"):
        assign_places([(0, 0), (1, 1)], [(0, 0)])


def test_nobody_is_assigned_to_nothing() -> None:
    assert assign_places([], []) == []
