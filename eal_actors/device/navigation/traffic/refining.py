"""Refinement: a plan is improved by planning a few of its travellers anew, again and again.

First each traveller alone, the most delayed first, until nothing improves; then small groups that are in each other's
way (large neighbourhood search). A change is kept if the sum of costs does not grow, so the plan is valid at any time.

Source: J. Li, Z. Chen, D. Harabor, P. J. Stuckey, S. Koenig, "Anytime Multi-Agent Path Finding via Large Neighborhood
Search", IJCAI 2021.
"""

from __future__ import annotations

import random
from typing import Final

from eal_actors.device.navigation.traffic.problem import NOBODY, Path, TrafficProblem
from eal_actors.device.navigation.traffic.timetable import Timetable

_GROUP: Final = 6
_SCANS: Final = 4
_IDLE_ROUNDS: Final = 200


def refine(problem: TrafficProblem, paths: list[Path], seed: int, max_work: int) -> list[Path]:
    """Return a plan of at most the cost of a valid one.

    `max_work` bounds the number of places and steps that are looked at; the last search may exceed it.
    """
    table, chance = Timetable(problem, paths), random.Random(seed)  # noqa: S311
    least = [distances[start] for distances, start in zip(problem.distances, problem.starts, strict=True)]
    delayed = True
    while delayed and table.work < max_work:
        late = [number for number in range(problem.size) if len(table.paths[number]) - 1 > least[number]]
        late.sort(key=lambda number: least[number] - len(table.paths[number]))
        delayed = False
        for number in late:
            if table.work < max_work:
                delayed |= _replan(table, [number])
    idle = 0
    while table.work < max_work and idle < _IDLE_ROUNDS:
        delays = [len(path) - 1 - steps for path, steps in zip(table.paths, least, strict=True)]
        if not any(delays):
            break
        number = chance.choices(range(problem.size), delays)[0]
        group = _group_of(problem, table, number, chance)
        chance.shuffle(group)
        idle = 0 if _replan(table, group) else idle + 1
    return table.paths


def _replan(table: Timetable, group: list[int]) -> bool:
    """Plan some travellers anew, one after the other; return whether the sum of costs has fallen."""
    old = {number: table.paths[number] for number in group}
    left = allowed = sum(len(path) - 1 for path in old.values())
    for number in group:
        table.remove(number)
    added = []
    for number in group:
        if (path := table.shortest(number, left)) is None:
            break
        table.add(number, path)
        added.append(number)
        left -= len(path) - 1
    if len(added) == len(group):
        return sum(len(table.paths[number]) - 1 for number in group) < allowed
    for number in added:
        table.remove(number)
    for number, path in old.items():
        table.add(number, path)
    return False


def _group_of(problem: TrafficProblem, table: Timetable, number: int, chance: random.Random) -> list[int]:
    """Return a traveller with others that stand in the way of better paths."""
    group = [number]
    for _ in range(_SCANS):
        if len(group) >= _GROUP:
            break
        walker = chance.choice(group)
        path, distances = table.paths[walker], problem.distances[walker]
        step = chance.randrange(len(path))
        place = path[step]
        while step + 1 < len(path) and len(group) < _GROUP:
            better = [other for other in problem.options(walker, place) if step + 1 + distances[other] < len(path) - 1]
            if not better:
                break
            place, step = chance.choice(better), step + 1
            other = table.visitor(step, place)
            if other != NOBODY and other not in group:
                group.append(other)
    return group
