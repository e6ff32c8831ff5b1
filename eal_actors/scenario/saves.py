"""Whether a scenario leaves files behind."""

from __future__ import annotations

from collections.abc import Sequence

from eal_actors.scenario.model import AnswerStep, AnyStep, inner_steps
from eal_actors.scenario.scenario import Scenario


def saves_files(scenario: Scenario) -> bool:
    """Return whether a scenario or one of its parts saves answers to files."""
    own = _saves(scenario.file.steps) or _saves(scenario.file.finally_)
    return own or any(saves_files(part) for part in scenario.parts.values())


def _saves(steps: Sequence[AnyStep]) -> bool:
    return any(
        (isinstance(step, AnswerStep) and step.save is not None) or any(_saves(inner) for _, inner in inner_steps(step))
        for step in steps
    )
