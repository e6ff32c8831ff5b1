"""Run scenarios on rigs and summarise their reports."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from eal_actors.facade.fleet import Fleet
from eal_actors.scenario import (
    Report,
    RunEvent,
    StepRecord,
    StepStarted,
    run_scenario,
)
from tests.scenarios.rig import HEAD, rigs, scenario

WAIT_S = 20.0
"""Real seconds after which a test that waits for something gives up."""


def run(fleet: Fleet, folder: Path, body: str, head: str = HEAD, **keywords: Any) -> Report:
    return run_scenario(scenario(folder, body, head), fleet, **keywords)


def run_rigs(
    folder: Path, body: str, listeners: Sequence[Callable[[RunEvent], object]] = (), **robots: Mapping[str, Any]
) -> Report:
    """Run a scenario on a fleet of rigs that is closed at the end."""
    with rigs(folder, clock=None, head="", **robots) as fleet:
        return run(fleet, folder, body, listeners=listeners)


def records(report: Report, robot: str) -> list[StepRecord]:
    return [record for record in report.steps if record.robot == robot]


def brief(report: Report, robot: str) -> list[tuple[str, str, int]]:
    return [(record.label, record.outcome, record.attempts) for record in records(report, robot)]


def outcomes(report: Report) -> dict[str, str]:
    return {name: robot.outcome for name, robot in report.robots.items()}


class Watch:
    """A listener that keeps the events and acts once, when a step with a label begins."""

    def __init__(self, label: str = "", action: Callable[[], object] = lambda: None) -> None:
        self.events: list[RunEvent] = []
        self._label = label
        self._action = action

    def __call__(self, event: RunEvent) -> None:
        self.events.append(event)
        if isinstance(event, StepStarted) and event.label == self._label:
            self._label = ""
            self._action()


THEN_NOW = "- on: all\n  do:\n  - send_cmd: {resource: Base, cmd: now}\n"
ON = "steps:\n- on: all\n  do:\n"
