"""The outline of a scenario: its steps as lines of a tree, without a fleet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from eal_actors.kernel.yaml_tree import YamlPath, format_path
from eal_actors.scenario.language.scenario import Scenario, Step


@dataclass(frozen=True, slots=True)
class OutlineLine:
    """A step, or a heading above steps, at a line of the scenario's file; it lies below `depth` other lines.

    The kind is that of the step; `branch` or `section` for a heading.
    """

    depth: int
    text: str
    kind: str
    line: int


def outline(scenario: Scenario) -> Iterator[OutlineLine]:
    """Yield the lines of a scenario in the order of its file, those of scenarios that it runs included."""
    for role, section in scenario.file.roles.items():
        words = [*(section.tags or ()), *(section.types or ()), *(section.robots or ())]
        who = f"role {role}: {', '.join(words) or 'all robots'}, at least {section.min}"
        yield OutlineLine(0, who, "role", scenario.tree.mark_at(("roles", role), key=True).line)
    for name, steps in (("steps", scenario.file.steps), ("finally", scenario.file.finally_)):
        if steps:
            yield OutlineLine(0, name, "section", scenario.tree.mark_at((name,), key=True).line)
            yield from _lines(scenario, steps, (name,), 1)


def _lines(scenario: Scenario, steps: Sequence[Step], path: YamlPath, depth: int) -> Iterator[OutlineLine]:
    for index, step in enumerate(steps):
        here = (*path, index)
        yield OutlineLine(depth, step.describe(scenario.parameters), step.kind, scenario.tree.mark_at(here).line)
        for keys, inner in step.children():
            words = step.branch_words(keys)
            if words is not None:
                yield OutlineLine(depth + 1, words[1], "branch", scenario.tree.mark_at((*here, *keys)).line)
            yield from _lines(scenario, inner, (*here, *keys), depth + (1 if words is None else 2))
        if (part := scenario.parts.get(format_path(here))) is not None:
            for name, of_part in (("steps", part.file.steps), ("finally", part.file.finally_)):
                yield from _lines(part, of_part, (name,), depth + 1)
