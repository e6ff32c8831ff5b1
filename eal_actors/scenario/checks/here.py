"""Where a check stands: the step, the robots that come to it, and what is known there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.checks.statics import Statics
from eal_actors.scenario.scenario import Scenario


class Place(NamedTuple):
    """Where a problem lies: a value, and the offset in its text."""

    path: YamlPath
    inside: tuple[str, int] | None = None


@dataclass(frozen=True, slots=True)
class Here:
    """Where a step stands.

    Attributes:
        scenario: the scenario that holds it.
        roles: the robots of its roles, spares included.
        groups: the robots of the `on` around it, those that are alike together.
        statics: what is known there before the run.
        role: the role of the `on` around it.
        is_of_one: each robot carries the scenario out by itself.
    """

    scenario: Scenario
    roles: Mapping[str, Sequence[str]]
    statics: Statics
    groups: tuple[tuple[str, ...], ...] = ()
    role: str = ""
    is_of_one: bool = False
