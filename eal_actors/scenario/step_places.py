"""Where in its file a step stands, given the path by which records name it."""

from __future__ import annotations

import re
from typing import Final

from eal_actors.kernel.yaml_tree import Mark, YamlPath
from eal_actors.scenario import Scenario

_ELEMENT: Final = re.compile(r"\[(\d+)\]|([^.\[\]]+)")


def step_place(scenario: Scenario, step: str) -> Mark:
    """Return the place of a step, in the file of the part that it belongs to.

    Args:
        scenario: the scenario that was run.
        step: its path, such as `steps[0].do[1]`; behind that of the step that carries out its part, if it is of one.
    """
    for path, part in scenario.parts.items():
        prefix = f"{path}.{part.name}."
        if step.startswith(prefix):
            return step_place(part, step.removeprefix(prefix))
    return scenario.tree.mark_at(_parsed(step))


def _parsed(step: str) -> YamlPath:
    return tuple(int(index) if index else name for index, name in _ELEMENT.findall(step))
