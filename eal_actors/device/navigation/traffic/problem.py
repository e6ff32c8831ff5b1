"""The planning problem: a graph of places on the floor, and travellers that move from place to place.

Time is in steps. In a step each traveller moves along one edge of the graph or stays. Two rules make plans safe for
robots whose speeds differ and that may stop at any time:

- A move excludes everybody else from its `block`: the places within the clearance of its whole way. For most moves
  between two places of the lattice these are the two places. A traveller may enter a place of the lattice in the step
  in which another one leaves it, for the executor lets it wait until the other one has arrived.
- No group of travellers moves round in a circle, each to the place of the next: nobody could go first. Two that swap
  are such a circle.

Other places are between those of the lattice: the own starts and goals of single travellers, and bridges. Those in a
block must be empty before and after the step. A move from or to such a place needs its whole block empty. Every joint
move is then a sequence of single moves, each of which keeps these rules, so they make no problem unsolvable.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, TypeAlias

Path: TypeAlias = list[int]
"""The place of a traveller at each step, from its start to its arrival at its goal, where it stays."""

NOBODY: Final = -1
FAR: Final = 1 << 30
"""The distance of a place from which a goal cannot be reached."""


@dataclass(frozen=True)
class TrafficProblem:
    """Travellers with a start and a goal on a graph.

    Attributes:
        neighbours: for each place, those that can be reached from it in one step.
        blocks: for each move (from, to) that excludes others from more than its two ends, all places it excludes them
            from, the ends included. It contains both directions.
        own_neighbours: for each traveller, additional neighbours of places, which nobody else can use.
        lattice: the number of places of the lattice; those with higher numbers are between them.
        anywhere: travellers that only make way: they may end anywhere, the nearer to their goals the better.
    """

    neighbours: Sequence[Sequence[int]]
    starts: tuple[int, ...]
    goals: tuple[int, ...]
    blocks: Mapping[tuple[int, int], frozenset[int]] = field(default_factory=dict)
    own_neighbours: Mapping[int, Mapping[int, Sequence[int]]] = field(default_factory=dict)
    lattice: int = FAR
    anywhere: frozenset[int] = frozenset()

    @property
    def size(self) -> int:
        """The number of travellers."""
        return len(self.starts)

    def late(self, places: Sequence[int]) -> tuple[int, ...]:
        """Return the travellers that are not where they must be in the end."""
        pairs = enumerate(zip(places, self.goals, strict=True))
        return tuple(number for number, (place, goal) in pairs if place != goal and number not in self.anywhere)

    @cached_property
    def distances(self) -> list[list[int]]:
        """For each traveller, the steps from each place to its goal, without others; FAR where there is no way."""
        return [self._distances(number) for number in range(self.size)]

    def is_between(self, here: int, there: int) -> bool:
        """Return whether a move is from or to a place that is not of the lattice."""
        return here >= self.lattice or there >= self.lattice

    def options(self, number: int, place: int) -> list[int]:
        """Return where a traveller can be one step later, its place included."""
        own = self.own_neighbours.get(number)
        return [*self.neighbours[place], *(own.get(place, ()) if own else ()), place]

    def _distances(self, number: int) -> list[int]:
        found = [FAR] * len(self.neighbours)
        neighbours, own = self.neighbours, self.own_neighbours.get(number, {})
        found[self.goals[number]] = 0
        queue = deque([self.goals[number]])
        while queue:
            place = queue.popleft()
            steps = found[place] + 1
            for other in (*neighbours[place], *own[place]) if place in own else neighbours[place]:
                if found[other] == FAR:
                    found[other] = steps
                    queue.append(other)
        return found

    @property
    def least_cost(self) -> int:
        """The sum of the shortest paths: no plan costs less."""
        return sum(table[start] for table, start in zip(self.distances, self.starts, strict=True))


def cost_of(paths: Sequence[Path]) -> int:
    """Return the sum of costs: for each traveller the steps until it has arrived for good."""
    return sum(len(path) - 1 for path in paths)


def trimmed(path: Path) -> Path:
    """Return a path without the stay at its end."""
    end = len(path)
    while end > 1 and path[end - 2] == path[-1]:
        end -= 1
    return path[:end]
