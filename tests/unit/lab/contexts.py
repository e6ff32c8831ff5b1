"""Contexts of Python steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from eal_actors.scenario.steps.python import StepContext
from tests.manual_clock import ManualClock


def step_context(
    directory: Path | None = None,
    *,
    robots: Mapping[str, Any] | None = None,
    robot: str | None = None,
    log: Callable[[str], None] = lambda _: None,
    is_cancelled: bool = False,
    keeps_files: bool = True,
) -> StepContext:
    """Return a context of a step outside of any run."""
    return StepContext(robots or {}, robot, directory, ManualClock(), {}, 0, lambda: is_cancelled, log, keeps_files)
