"""Timetable: who is where in each step of a plan, and the shortest path of one traveller between all others."""

from __future__ import annotations

import heapq
import itertools
from collections import Counter
from collections.abc import Iterator

from eal_actors.device.navigation.traffic.problem import NOBODY, Path, TrafficProblem

_SLACK_STEPS = 16  # steps after the last arrival, so that a new path may be later than all others


class Timetable:
    """The paths of travellers, by step and place. `work` is the number of places and steps looked at so far."""

    def __init__(self, problem: TrafficProblem, paths: list[Path]) -> None:
        self._problem = problem
        self.paths = list(paths)
        self.end = max(len(path) for path in paths) + _SLACK_STEPS
        self._at = [[NOBODY] * len(problem.neighbours) for _ in range(self.end + 1)]
        self._closed: Counter[tuple[int, int]] = Counter()  # steps and places that a move with a larger block closes
        self.work = 0
        for number in range(problem.size):
            self.add(number, paths[number])

    def place_of(self, number: int, step: int) -> int:
        """Return where a traveller is."""
        path = self.paths[number]
        return path[step] if step < len(path) else path[-1]

    def visitor(self, step: int, place: int) -> int:
        """Return who is at a place, or NOBODY."""
        return self._at[min(step, self.end)][place]

    def add(self, number: int, path: Path) -> None:
        """Enter a traveller's path."""
        self.paths[number] = path
        self._mark(path, number)
        self._closed.update(self._closures(path))

    def remove(self, number: int) -> None:
        """Take a traveller out."""
        path = self.paths[number]
        self._mark(path, NOBODY)
        self._closed.subtract(self._closures(path))

    def _mark(self, path: Path, number: int) -> None:
        for row, place in zip(self._at, path, strict=False):
            row[place] = number
        goal = path[-1]
        for row in self._at[len(path) :]:
            row[goal] = number

    def _closures(self, path: Path) -> Iterator[tuple[int, int]]:
        blocks, is_between = self._problem.blocks, self._problem.is_between
        if blocks:
            for step, (here, there) in enumerate(itertools.pairwise(path)):
                for near in blocks.get((here, there), ()):
                    if near not in {here, there} or is_between(here, there):
                        yield step, near
                        yield step + 1, near

    def shortest(self, number: int, most_steps: int) -> Path | None:
        """Return the shortest path of a traveller that was removed, by A* over places and steps.

        None if it takes more than `most_steps`.
        """
        problem, table, places = self._problem, self._problem.distances[number], len(self._problem.neighbours)
        start, goal, span = problem.starts[number], problem.goals[number], self.end + 1
        free_from = self.end + 1  # nobody visits the goal from then on
        while free_from and self._at[free_from - 1][goal] == NOBODY and not self._closed[free_from - 1, goal]:
            free_from -= 1
        most_steps = min(most_steps, self.end)
        entries = [(max(table[start], free_from) * span + span) * places + start]
        before: dict[int, int] = {start: NOBODY}  # by step * places + place
        while entries:
            rest, place = divmod(heapq.heappop(entries), places)
            step = span - rest % span if rest % span else 0
            self.work += 1
            if place == goal and step >= free_from:
                return trace(before, step * places + place, places)
            if step >= most_steps:
                continue
            later = (step + 1) * places
            for other in self._open_moves(number, place, step):
                total = max(step + 1 + table[other], free_from)
                if total <= most_steps and later + other not in before:
                    before[later + other] = step * places + place
                    heapq.heappush(entries, (total * span + span - step - 1) * places + other)
        return None

    def _open_moves(self, number: int, place: int, step: int) -> list[int]:
        now, after, blocks, closed = self._at[step], self._at[step + 1], self._problem.blocks, self._closed
        found = []
        for other in self._problem.options(number, place):
            if after[other] != NOBODY or (closed and closed[step + 1, other]):
                continue
            block = blocks.get((place, other)) if blocks else None
            if block is not None and not self._is_empty(block - self._shared_ends(place, other), step):
                continue
            if now[other] == NOBODY or not self._closes_circle(place, other, step):
                found.append(other)
        return found

    def _shared_ends(self, here: int, there: int) -> frozenset[int]:
        """Return the ends of a move that somebody else may leave or enter in the same step."""
        return frozenset() if self._problem.is_between(here, there) else frozenset((here, there))

    def _is_empty(self, block: frozenset[int], step: int) -> bool:
        now, after = self._at[step], self._at[step + 1]
        return not any(now[near] != NOBODY or after[near] != NOBODY for near in block)

    def _closes_circle(self, here: int, place: int, step: int) -> bool:
        """Return whether those that leave for each other's places would be in a circle with the traveller."""
        now = self._at[step]
        while (other := now[place]) != NOBODY:
            after = self.place_of(other, step + 1)
            if after == here:
                return True
            if after == place:
                return False
            place = after
        return False


def trace(before: dict[int, int], code: int, places: int) -> Path:
    """Return the path to a step and place, encoded as step * places + place."""
    path = []
    while code != NOBODY:
        path.append(code % places)
        code = before[code]
    return path[::-1]
