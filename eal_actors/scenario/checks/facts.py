"""What robots can do, as far as a check must know it, and which of them are alike."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from eal_actors.device.info import ResourceInfo

_MOST_NAMED: Final = 3


@dataclass(frozen=True, slots=True)
class RobotFacts:
    """What a check must know of a robot.

    Attributes:
        resources: what its resources say of themselves, by name.
        left_out: why it may have fewer than one would think; empty for no reason.
    """

    resources: Mapping[str, ResourceInfo]
    left_out: str = ""


def kinds_of(robots: Mapping[str, RobotFacts]) -> dict[str, int]:
    """Return a number for each robot: the same for those whose resources say the same of themselves."""
    kinds: list[Mapping[str, ResourceInfo]] = []
    found: dict[str, int] = {}
    for name, facts in robots.items():
        number = next((index for index, known in enumerate(kinds) if known == facts.resources), len(kinds))
        if number == len(kinds):
            kinds.append(facts.resources)
        found[name] = number
    return found


def shown_robots(robots: Iterable[str]) -> str:
    """Return the names of robots, the first few where they are many."""
    names = list(robots)
    more = len(names) - _MOST_NAMED
    return ", ".join(names) if more <= 0 else f"{', '.join(names[:_MOST_NAMED])} and {more} more"
