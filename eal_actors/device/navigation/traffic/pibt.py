"""PIBT: one step of all travellers, each as near to its goal as those of higher priority let it.

A traveller that wants a place where another one is lends it its priority: the other one must leave first, and if it
cannot, the first one takes its next best place.

Source: K. Okumura, M. Machida, X. Défago, Y. Tamura, "Priority inheritance with backtracking for iterative multi-agent
path finding", Artificial Intelligence 310, 2022.
"""

from __future__ import annotations

import random
from collections.abc import Sequence

from eal_actors.device.navigation.traffic.problem import FAR, NOBODY, TrafficProblem


class StepGenerator:
    """Generates configurations: the places of all travellers one step later.

    `work` is the number of travellers placed so far.
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
        self._closed: list[int] = []  # by place, the number of moves whose blocks it is in
        self.work = 0

    def generate(
        self, now: Sequence[int], order: Sequence[int], fixed: Sequence[tuple[int, int]]
    ) -> tuple[int, ...] | None:
        """Return the next configuration; None if there is none under the constraints.

        `now` has the place of each traveller; `order` has the highest priority first; `fixed` travellers must be where
        it says.
        """
        places = len(self._problem.neighbours)
        self._now = now
        self._at, self._taken, self._closed = [NOBODY] * places, [NOBODY] * places, [0] * places
        self._next = [NOBODY] * len(now)
        for number, place in enumerate(now):
            self._at[place] = number
        for number, place in fixed:
            if not self._may_enter(number, place) or self._closes_circle(number, place):
                return None
            self._take(number, place)
        for number in order:
            if self._next[number] == NOBODY and not self._place(number):
                return None
        return tuple(self._next)

    def _place(self, number: int) -> bool:
        """Place a traveller and those that must give way to it; if nothing is free it stays, and the result is False.

        The recursion is as deep as a queue of travellers is long; the planner bounds their number.
        """
        self.work += 1
        here = self._now[number]
        for place in self._ranked(number, here):
            if not self._may_enter(number, place):
                if self._waits_for_block(number, place):
                    return True
                continue
            other = self._at[place]
            if other not in {NOBODY, number} and self._next[other] != NOBODY and self._closes_circle(number, place):
                continue
            self._take(number, place)
            if other in {NOBODY, number} or self._next[other] != NOBODY or self._place(other):
                return True
            self._count_closed(here, place, -1)
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

    def _may_enter(self, number: int, place: int) -> bool:
        """Return whether the rules allow a move, except for those about circles."""
        taken, at, here = self._taken, self._at, self._now[number]
        if taken[place] != NOBODY or self._closed[place]:  # one's own place is closed while somebody waits for it
            return False
        if place == here or not self._blocks:
            return True
        if (block := self._blocks.get((here, place))) is None:
            return True
        if self._problem.is_between(here, place):
            return all(taken[near] == NOBODY and at[near] in {NOBODY, number} for near in block)
        return all(near in {here, place} or (taken[near] == NOBODY and at[near] == NOBODY) for near in block)

    def _take(self, number: int, place: int) -> None:
        here = self._now[number]
        self._next[number], self._taken[place] = place, number
        self._count_closed(here, place, 1)

    def _count_closed(self, here: int, place: int, by: int) -> None:
        """Count the places that nobody else may enter during a move."""
        block = self._blocks.get((here, place), frozenset())
        for near in block if self._problem.is_between(here, place) else block - {here, place}:
            self._closed[near] += by

    def _closes_circle(self, number: int, place: int) -> bool:
        """Return whether those that leave for each other's places would be in a circle with this traveller."""
        here, now, following = self._now[number], self._now, self._next
        while (other := self._at[place]) not in {NOBODY, number}:
            place = following[other]
            if place == here:
                return True
            if place in {NOBODY, now[other]}:
                return False
        return False

    def _waits_for_block(self, number: int, place: int) -> bool:
        """Let those that are too near the best way leave first; return whether the traveller stays and waits for it."""
        here, table, block = self._now[number], self._distances[number], self._blocks.get((self._now[number], place))
        if block is None or self._taken[here] != NOBODY or table[place] >= table[here]:
            return False
        self._take(number, here)
        for near in block:
            self._closed[near] += 1
        for near in block:
            other = self._at[near]
            if other != NOBODY and self._next[other] == NOBODY and self._taken[near] == NOBODY:
                self._place(other)
        for near in block:
            self._closed[near] -= 1
        return True
