"""Action dependency graph: which moves of others must be over before a move may begin.

A plan's steps are a notion of the planner: robots do not keep step. What must be kept is the order in which robots pass
the places. So each move waits for the moves of others that leave a place which it excludes them from, and for nothing
else. The graph has no circle, so there is always a move that may begin, whatever the delays.

Source: W. Hönig, S. Kiesel, A. Tinka, J. W. Durham, N. Ayanian, "Persistent and Robust Execution of MAPF Schedules in
Warehouses", IEEE Robotics and Automation Letters 4(2), 2019.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from eal_actors.device.navigation.traffic.problem import Path, TrafficProblem


@dataclass(frozen=True, slots=True)
class PlannedMove:
    """A move of one traveller.

    `waits_for` are travellers, and how many of their moves must be over before this one begins.
    """

    there: int
    waits_for: tuple[tuple[int, int], ...]


def action_graph(problem: TrafficProblem, paths: Sequence[Path]) -> list[list[PlannedMove]]:
    """Return the moves of each traveller of a valid plan in their order."""
    moves: list[list[PlannedMove]] = [[] for _ in paths]
    ended_at: defaultdict[int, dict[int, int]] = defaultdict(dict)  # by place and traveller, its moves
    swept: defaultdict[int, dict[int, int]] = defaultdict(dict)  # the same for places that its moves block
    known: list[dict[int, int]] = [{} for _ in paths]
    for number, here, there in _in_order(paths):
        block = problem.blocks.get((here, there), frozenset((here, there)))
        needed: dict[int, int] = {}
        for found in (*(ended_at[place] for place in block), swept[here], swept[there]):
            for other, count in found.items():
                needed[other] = max(count, needed.get(other, 0))
        needed.pop(number, None)
        new = {other: count for other, count in sorted(needed.items()) if count > known[number].get(other, 0)}
        known[number].update(new)
        moves[number].append(PlannedMove(there, tuple(new.items())))
        for place in (here, there):
            ended_at[place][number] = len(moves[number])
        for place in block:
            swept[place][number] = len(moves[number])
    return moves


def _in_order(paths: Sequence[Path]) -> Iterator[tuple[int, int, int]]:
    """Yield each move as traveller, from and to; in a step, those that make way go first."""
    for step in range(max(map(len, paths), default=0) - 1):
        going = {path[step]: number for number, path in enumerate(paths) if _goes(path, step)}
        while going:
            chain = [next(iter(going))]
            while (place := paths[going[chain[-1]]][step + 1]) in going:
                chain.append(place)
            for place in reversed(chain):
                number = going.pop(place)
                yield number, place, paths[number][step + 1]


def _goes(path: Path, step: int) -> bool:
    return step + 1 < len(path) and path[step] != path[step + 1]
