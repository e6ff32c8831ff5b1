"""The cases of a proof: which faults happen, and when. Pure.

Each fault is tried in each step of each robot, in the middle of the step, or just before a step that takes no time.
The first pass of a loop comes before the second, so that a small budget covers every step once. A share of the budget
is for pairs of faults, chosen at random from the fleet's seed.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from eal_actors.managers.manifest import FaultSection
from eal_actors.scenario import Report

KILLED: Final = "controller-killed"
"""The fault of the controller: its process dies, the robots halt, and another process resumes the run."""

_INSTANT_S: Final = 0.04
_BEFORE_S: Final = 0.02
_SHARE_OF_PAIRS: Final = 5
_RESOURCE: Final = "{resource}"


@dataclass(frozen=True, slots=True)
class Position:
    """A step of a robot, as the run without faults performed it.

    Attributes:
        number: how often the robot has performed it, this time included.
        resource: the resource that it calls; None if it may call any.
        at_s: when a fault in it happens, in seconds since the run's start.
    """

    robot: str
    step: str
    number: int
    label: str
    resource: str | None
    at_s: float


@dataclass(frozen=True, slots=True)
class InjectedFault:
    """A fault at a position.

    Attributes:
        at_s: when it begins, in seconds of the fleet's clock.
        until_s: when it ends; None for never.
        instance: the plugin instance that injects it.
        settings: its entry in the setting `faults`, without times; empty for a fault of the controller.
        is_unreachable: nobody reaches the robot meanwhile.
    """

    kind: str
    position: Position
    at_s: float
    until_s: float | None = None
    instance: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    is_unreachable: bool = False

    @property
    def robot(self) -> str:
        """The robot in whose step it happens."""
        return self.position.robot

    @property
    def label(self) -> str:
        """The fault for people."""
        where = self.position
        again = f", time {where.number}" if where.number > 1 else ""
        who = "" if self.kind == KILLED else f"{where.robot} "
        return f"{who}{self.kind} in {where.step}{again} ({where.label}), at {self.at_s:.2f} s"


FaultCase = tuple[InjectedFault, ...]
"""The faults of one run."""

Injectable = Mapping[str, tuple[str, Mapping[str, FaultSection]]]
"""By robot, the plugin instance that injects its faults, and the faults by name."""


def find_positions(report: Report) -> tuple[Position, ...]:
    """Return the steps of all robots, in the order of their passes, then of their starts.

    A step outside of `on`, such as a formation, is one of each robot that took part.
    """
    seen: Counter[tuple[str, str]] = Counter()
    found = []
    for record in sorted(report.steps, key=lambda record: record.start_s):
        is_instant = record.end_s - record.start_s < _INSTANT_S
        at_s = max(0.0, record.start_s - _BEFORE_S) if is_instant else (record.start_s + record.end_s) / 2
        part = [name for name, robot in report.robots.items() if robot.outcome != "spare"]
        for name in part if record.robot is None else [record.robot]:
            seen[name, record.step] += 1
            found.append(Position(name, record.step, seen[name, record.step], record.label, record.resource, at_s))
    return tuple(sorted(found, key=lambda position: position.number))


def single_faults(
    positions: Sequence[Position], injectable: Injectable, start_s: float, kinds: Sequence[str] = ()
) -> list[FaultCase]:
    """Return a case for each fault, or of these kinds alone, at each position; one for the controller at each time."""
    cases: list[FaultCase] = []
    kills: set[float] = set()
    for position in positions:
        at_s = round(start_s + position.at_s, 3)
        if at_s not in kills and (not kinds or KILLED in kinds):
            kills.add(at_s)
            cases.append((InjectedFault(KILLED, position, at_s),))
        instance, faults = injectable.get(position.robot, ("", {}))
        for kind, fault in faults.items():
            if (not kinds or kind in kinds) and _can_happen(fault, position):
                until_s = None if fault.lasts_s is None else at_s + fault.lasts_s
                settings = _fill_in(fault.settings, position.resource)
                cases.append((InjectedFault(kind, position, at_s, until_s, instance, settings, fault.unreachable),))
    return cases


def plan_cases(singles: Sequence[FaultCase], runs: int, seed: int) -> list[FaultCase]:
    """Return at most `runs` cases: single faults first, then pairs of them, which the seed chooses."""
    kept = list(singles[: max(runs - runs // _SHARE_OF_PAIRS, runs - len(singles))])
    return kept + _pairs([one for one in singles if one[0].kind != KILLED], runs - len(kept), seed)


def _pairs(singles: Sequence[FaultCase], count: int, seed: int) -> list[FaultCase]:
    chance = random.Random(seed)  # noqa: S311  # a plan of simulations
    found: dict[tuple[int, int], None] = {}
    for _ in range(20 * count):
        if len(found) == count or len(singles) < 2:
            break
        one, other = sorted(chance.sample(range(len(singles)), 2))
        if singles[one][0].position != singles[other][0].position:
            found[one, other] = None
    return [(singles[one][0], singles[other][0]) for one, other in found]


def _can_happen(fault: FaultSection, position: Position) -> bool:
    if position.resource is None:
        return _RESOURCE not in str(fault.settings)
    return not fault.resources or position.resource in fault.resources


def _fill_in(value: Any, resource: str | None) -> Any:
    if isinstance(value, Mapping):
        return {key: _fill_in(item, resource) for key, item in value.items()}
    if isinstance(value, list):
        return [_fill_in(item, resource) for item in value]
    return value.replace(_RESOURCE, resource or "") if isinstance(value, str) else value
