"""Assignment of robots to places with the least sum of squared distances."""

from __future__ import annotations

import math
from collections.abc import Sequence

from eal_actors.device.localization.pose_estimate import Point
from eal_actors.kernel.errors import ArgumentError


def assign_places(starts: Sequence[Point], places: Sequence[Point]) -> list[int]:
    """Return for each start the number of its place, minimising the sum of squared distances.

    Squares, because then no two robots swap sides: `(s_i - s_j) · (p_i - p_j) >= 0` for all i, j; and no robot's path
    lies completely on another's. Raises ArgumentError if the numbers of places and robots differ.
    """
    if len(starts) != len(places):
        raise ArgumentError(f"{len(starts)} robots need as many places, not {len(places)}")
    return least_assignment([[math.dist(start, place) ** 2 for place in places] for start in starts])


def least_assignment(costs: Sequence[Sequence[float]]) -> list[int]:
    """Return for each row of (n, n) finite costs its column, each column once, minimising their sum.

    Hungarian method with potentials: O(n³), 0.1 s for 100 rows.
    """
    size = len(costs)
    row_potential, column_potential = [0.0] * (size + 1), [0.0] * (size + 1)
    row_of = [0] * (size + 1)  # row of each column, counted from 1; column 0 holds the row to place
    for row in range(1, size + 1):
        row_of[0] = row
        before = _cheapest_chain(costs, row_of, row_potential, column_potential)
        column = before.pop()
        while column:  # each row of the chain moves to the next column
            row_of[column] = row_of[before[column]]
            column = before[column]
    columns = [0] * size
    for column in range(1, size + 1):
        columns[row_of[column] - 1] = column - 1
    return columns


def _cheapest_chain(
    costs: Sequence[Sequence[float]], row_of: list[int], row_potential: list[float], column_potential: list[float]
) -> list[int]:
    """Return the predecessor of each column in the augmenting path, then the free column at its end.

    Updates the potentials.
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
