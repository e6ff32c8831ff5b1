"""PIBT: one step of all travellers, each as near to its goal as those of higher priority let it.

A traveller that wants a place where another one is lends it its priority: the other one must leave first, and if it
cannot, the first one takes its next best place.

Source: K. Okumura, M. Machida, X. Défago, Y. Tamura, "Priority inheritance with backtracking for iterative multi-agent
path finding", Artificial Intelligence 310, 2022.
"""

from __future__ import annotations

import random
from collections.abc import Sequence

from eal_actors.navigation.traffic.problem import FAR, NOBODY, TrafficProblem


class StepGenerator:
    """Generates configurations: the places of all travellers one step later.

    Args:
        problem: the problem.
        random_numbers: breaks ties.

    Attributes:
        work: the number of travellers placed so far.
    """

    def __init__(self, problem: TrafficProblem, random_numbers: random.Random) -> None:
        self._problem = problem
        self._blocks = problem.blocks
        self._random = random_numbers.random
        self._distances = problem.distances
        self._now: Sequence[int] = ()
        self._at: list[int] = []
        self._next: list[int] = []
        self._taken: list[int] = []
        self.work = 0

    def generate(
        self, now: Sequence[int], order: Sequence[int], fixed: Sequence[tuple[int, int]]
    ) -> tuple[int, ...] | None:
        """Return the next configuration; None if there is none under the constraints.

        Args:
            now: the place of each traveller.
            order: the travellers, the highest priority first.
            fixed: travellers and where they must be next.
        """
        places = len(self._problem.neighbours)
        self._now = now
        self._at, self._taken = [NOBODY] * places, [NOBODY] * places
        self._next = [NOBODY] * len(now)
        for number, place in enumerate(now):
            self._at[place] = number
        if not all(self._fix(number, place) for number, place in fixed):
            return None
        for number in order:
            if self._next[number] == NOBODY and not self._place(number):
                return None
        return tuple(self._next)

    def _fix(self, number: int, place: int) -> bool:
        here = self._now[number]
        block = self._blocks.get((here, place))
        if place == here or block is None:
            if self._taken[place] != NOBODY or self._closes_circle(number, place):
                return False
            self._next[number] = place
            self._taken[place] = number
            return True
        return self._enter_block(number, place, block)

    def _place(self, number: int) -> bool:
        """Place a traveller and those that must give way to it; if nothing is free it stays, and the result is False.

        Recursion is as deep as a queue of travellers is long; the planner bounds their number.
        """
        self.work += 1
        here = self._now[number]
        for place in self._ranked(number, here):
            if place == here:
                if self._taken[here] == NOBODY:
                    break
                continue
            block = self._blocks.get((here, place))
            if block is not None:
                if self._enter_block(number, place, block) or self._clear_block(number, place, block):
                    return True
                continue
            if self._taken[place] != NOBODY:
                continue
            other = self._at[place]
            if other != NOBODY and self._next[other] != NOBODY and self._closes_circle(number, place):
                continue
            self._next[number], self._taken[place] = place, number
            if other == NOBODY or self._next[other] != NOBODY or self._place(other):
                return True
        is_free = self._taken[here] == NOBODY
        self._next[number], self._taken[here] = here, number
        return is_free

    def _ranked(self, number: int, here: int) -> list[int]:
        """Return where a traveller can go, the nearest to its goal first; of equal ones, empty places first."""
        table, at, chance = self._distances[number], self._at, self._random
        ranked = [
            (table[place] + (0.5 if at[place] != NOBODY and place != here else 0.0) + 0.4 * chance(), place)
            for place in self._problem.options(number, here)
        ]
        ranked.sort()
        return [place for rank, place in ranked if rank < FAR]

    def _closes_circle(self, number: int, place: int) -> bool:
        """Return whether those that leave for each other's places would be in a circle with this traveller."""
        here, now, following = self._now[number], self._now, self._next
        while (other := self._at[place]) != NOBODY and other != number:
            place = following[other]
            if place == here:
                return True
            if place in {NOBODY, now[other]}:
                return False
        return False

    def _enter_block(self, number: int, place: int, block: frozenset[int]) -> bool:
        """Move where nobody else may be near, if nobody is."""
        at, taken = self._at, self._taken
        if any(taken[near] != NOBODY or at[near] not in {NOBODY, number} for near in block):
            return False
        self._next[number] = place
        for near in block:
            taken[near] = number
        return True

    def _clear_block(self, number: int, place: int, block: frozenset[int]) -> bool:
        """Wait for those that are too near the best way to leave; return whether the traveller waits."""
        here, table = self._now[number], self._distances[number]
        if self._taken[here] != NOBODY or table[place] >= table[here]:
            return False
        self._next[number] = here
        for near in block:
            if self._taken[near] == NOBODY:
                self._taken[near] = number
        for near in block:
            other = self._at[near]
            if other != NOBODY and self._next[other] == NOBODY:
                self._place(other)
        return True
