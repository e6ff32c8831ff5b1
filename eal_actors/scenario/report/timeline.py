"""The timeline of a plan: what each robot will do, in order, with loops folded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, TypeAlias

from eal_actors.kernel.yaml_tree import YamlPath, format_path
from eal_actors.scenario.language.scenario import Scenario, Step
from eal_actors.scenario.language.scope import ROBOT_FACTS, RUN


@dataclass(frozen=True, slots=True)
class TimelineEntry:
    """One line of a timeline.

    Attributes:
        kind: the kind of the step; `branch` for a branch of a `parallel`, `then` and `else` for those of `if`.
        robots: the robots that do it; empty outside of `on`.
        calls: number of its calls if nothing fails; None if it is known only during the run.
        unknown: the variables and readings that are known only during the run.
    """

    step: str
    kind: str
    text: str
    robots: tuple[str, ...] = ()
    calls: int | None = 0
    unknown: tuple[str, ...] = ()
    inner: tuple[TimelineEntry, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return plain dicts, lists, strings and numbers."""
        return asdict(self)


StepTimeline: TypeAlias = tuple[tuple[str, ...], tuple[TimelineEntry, ...]]
"""The robots of a step's entry, and the entries inside it."""


@dataclass(frozen=True, slots=True)
class Timeline:
    """The timeline of a plan."""

    steps: tuple[TimelineEntry, ...]
    ending: tuple[TimelineEntry, ...]

    @classmethod
    def of(cls, scenario: Scenario, roles: Mapping[str, Sequence[str]]) -> Timeline:
        """Return the timeline of a scenario with these robots in its roles."""
        builder = TimelineBuilder(scenario, roles)
        file = scenario.file
        return cls(builder.entries(file.steps, ("steps",), ()), builder.entries(file.finally_, ("finally",), ()))


@dataclass(frozen=True, slots=True)
class TimelineBuilder:
    """Makes the entries for the steps of one scenario."""

    scenario: Scenario
    roles: Mapping[str, Sequence[str]]
    _prefix: str = ""

    def entries(self, steps: Sequence[Step], path: YamlPath, robots: tuple[str, ...]) -> tuple[TimelineEntry, ...]:
        """Return an entry for each step."""
        return tuple(self._entry(step, (*path, index), robots) for index, step in enumerate(steps))

    def children(self, step: Step, path: YamlPath, robots: tuple[str, ...]) -> tuple[TimelineEntry, ...]:
        """Return the entries inside a step: of its branches, or of the steps themselves."""
        found: list[TimelineEntry] = []
        for keys, steps in step.children():
            inner = self.entries(steps, (*path, *keys), robots)
            branch = step.branch_words(keys)
            if branch is None:
                found += inner
            else:
                name = f"{self._prefix}{format_path((*path, *keys))}"
                found.append(TimelineEntry(name, *branch, robots, _total(inner, 1), (), inner))
        return tuple(found)

    def part(self, part: Scenario, path: YamlPath, roles: Mapping[str, Sequence[str]]) -> tuple[TimelineEntry, ...]:
        """Return the entries of a scenario that the step at a path runs."""
        builder = TimelineBuilder(part, roles, f"{self._prefix}{format_path(path)}.{part.name}.")
        steps = builder.entries(part.file.steps, ("steps",), ())
        return (*steps, *builder.entries(part.file.finally_, ("finally",), ()))

    def _entry(self, step: Step, path: YamlPath, robots: tuple[str, ...]) -> TimelineEntry:
        own = step.own_calls(len(robots))
        robots, inner = step.timeline(self, path, robots)
        total = _total(inner, step.passes(self.scenario))
        return TimelineEntry(
            f"{self._prefix}{format_path(path)}",
            step.kind,
            step.describe(self.scenario.parameters),
            robots,
            None if total is None else own + total,
            self._unknown(step),
            inner,
        )

    def _unknown(self, step: Step) -> tuple[str, ...]:
        """Return the names that a step itself needs and that are known only during the run."""
        found: dict[str, None] = {}
        for located in step.expressions():
            for name in located.expression.names:
                if name.name not in self.scenario.parameters and name.name not in ROBOT_FACTS and name.name != RUN:
                    found[name.name] = None
            for reading, _ in located.expression.readings:
                found[str(reading)] = None
        return tuple(found)


def _total(entries: Sequence[TimelineEntry], passes: int | None) -> int | None:
    """Return the calls of entries that run several times, or None if the number is unknown."""
    calls = [entry.calls for entry in entries]
    if any(call is None for call in calls) or (passes is None and any(calls)):
        return None
    return (passes or 0) * sum(call or 0 for call in calls)
