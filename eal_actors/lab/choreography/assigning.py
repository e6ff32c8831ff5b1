"""Who goes to which place: the assignment of the least sum of squared ways."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

from eal_actors.kernel.errors import ArgumentError

Point: TypeAlias = tuple[float, float]
"""x and y in m."""


def assign_places(starts: Sequence[Point], places: Sequence[Point]) -> list[int]:
    """Return for each start the number of its place, so that the sum of the squared ways is least.

    Squares, not lengths: then no two robots want to change sides, `(s_i - s_j) · (p_i - p_j) >= 0` for all i, j, and
    nobody's whole way lies on the way of another.

    Args:
        starts: where the robots stand.
        places: where they are wanted; as many.

    Raises:
        ArgumentError: there are more or fewer places than robots.
    """
    if len(starts) != len(places):
        raise ArgumentError(f"{len(starts)} robots need as many places, not {len(places)}")
    costs = [[math.dist(start, place) ** 2 for place in places] for start in starts]
    return least_assignment(costs)


def least_assignment(costs: Sequence[Sequence[float]]) -> list[int]:
    """Return for each row the column that it is given, each column once, so that the sum of the costs is least.

    The Hungarian method with potentials: O(n³), a tenth of a second for 100 rows.

    Args:
        costs: shape (n, n), finite.
    """
    size = len(costs)
    row_potential, column_potential = [0.0] * (size + 1), [0.0] * (size + 1)
    row_of = [0] * (size + 1)  # of each column, counted from 1; column 0 holds the row that is being placed
    for row in range(1, size + 1):
        row_of[0] = row
        before = _cheapest_chain(costs, row_of, row_potential, column_potential)
        column = before.pop()
        while column:  # along the chain each row moves on to the next column
            row_of[column] = row_of[before[column]]
            column = before[column]
    columns = [0] * size
    for column in range(1, size + 1):
        columns[row_of[column] - 1] = column - 1
    return columns


def _cheapest_chain(
    costs: Sequence[Sequence[float]], row_of: list[int], row_potential: list[float], column_potential: list[float]
) -> list[int]:
    """Return for each column the one before it in the chain of moves that frees a column, and at last that column.

    Updates the potentials on the way.
    """
    size = len(costs)
    slack = [math.inf] * (size + 1)
    before, is_used = [0] * (size + 1), [False] * (size + 1)
    column = 0
    while row_of[column]:
        is_used[column] = True
        row, nearest, step = row_of[column], 0, math.inf
        for other in range(1, size + 1):
            if is_used[other]:
                continue
            reduced = costs[row - 1][other - 1] - row_potential[row] - column_potential[other]
            if reduced < slack[other]:
                slack[other], before[other] = reduced, column
            if slack[other] < step:
                step, nearest = slack[other], other
        for other in range(size + 1):
            if is_used[other]:
                row_potential[row_of[other]] += step
                column_potential[other] -= step
            else:
                slack[other] -= step
        column = nearest
    return [*before, column]
