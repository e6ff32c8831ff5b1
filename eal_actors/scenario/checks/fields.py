"""The numbers of steps that may be worked out, and what they may be."""

from __future__ import annotations

import math
from typing import Literal

from eal_actors.kernel.errors import ScenarioError
from eal_actors.scenario.expressions.functions import as_text
from eal_actors.scenario.model import (
    MAX_REPEATS,
    AnyStep,
    BlockStep,
    RepeatStep,
    TimedStep,
    WaitForStep,
    WaitingStep,
    WaitStep,
    WhileStep,
)

Wanted = Literal["seconds", "timeout", "count"]
"""Seconds from 0, seconds over 0, a whole number from 1."""


def static_numbers(step: AnyStep) -> list[tuple[tuple[str, ...], str, Wanted]]:
    """Return the numbers of a step that stand there as `${...}`: their keys, their texts, and what they may be."""
    found: list[tuple[tuple[str, ...], object, Wanted]] = []
    if isinstance(step, BlockStep | TimedStep | WaitingStep) and step.timeout_s is not None:
        found.append((("timeout_s",), step.timeout_s, "timeout"))
    match step:
        case WaitStep():
            found.append((("wait_s",), step.wait_s, "seconds"))
        case RepeatStep():
            found.append((("repeat",), step.repeat, "count"))
        case WhileStep():
            found.append((("limit",), step.limit, "count"))
        case WaitForStep():
            found.append((("count",), step.count, "count"))
    return [(keys, value, wanted) for keys, value, wanted in found if isinstance(value, str)]


def number_problem(value: object, wanted: Wanted) -> str | None:
    """Return why a value that was worked out cannot be such a number, or None."""
    if wanted == "count":
        fits = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MAX_REPEATS
        return None if fits else f"must be a whole number from 1 to {MAX_REPEATS}, not {_shown(value)}"
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not is_number:
        return f"must be a number, not {_shown(value)}"
    if wanted == "timeout" and not value > 0:  # type: ignore[operator]  # it is a number
        return f"must be over 0, not {_shown(value)}"
    if not value >= 0:  # type: ignore[operator]
        return f"must be at least 0, not {_shown(value)}"
    return None


def checked_number(value: object, wanted: Wanted, what: str) -> float:
    """Return a number that was worked out during the run.

    Raises:
        ScenarioError: it cannot be such a number.
    """
    if (problem := number_problem(value, wanted)) is not None:
        raise ScenarioError(f"{what} {problem}")
    return value  # type: ignore[return-value]  # it is a number


def _shown(value: object) -> str:
    return as_text(value) if isinstance(value, bool | int | float) else repr(value)
