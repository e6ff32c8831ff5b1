"""The state of an interrupted run, read from its folder."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from eal_actors.kernel.errors import EALError, ScenarioError
from eal_actors.scenario.language.scenario import Scenario, scenario_hash
from eal_actors.scenario.report.events import RunStarted, read_events
from eal_actors.scenario.report.journal import EVENTS, SUMMARY
from eal_actors.scenario.report.summary import ErrorReport, StartReport, StepRecord


@dataclass(frozen=True, slots=True)
class Resumption:
    """The point at which an interrupted run continues.

    Attributes:
        started: the fields of its event `run_started`.
        first_step: index of the top-level step at which it continues.
        since: the events after the last checkpoint.
        slots: by role, the robot of each slot and the variables of the slot.
        signals: by name, how often each was given, and its last value.
        unsaved: variables whose values are not in the record.
        gone: robots that left the run, with their outcome and error.
        records: the steps that were over, and those under way at the interruption, as `aborted`.
        continued_s: the times at which it was resumed before.
    """

    directory: Path
    started: Mapping[str, Any]
    first_step: int = 0
    was_begun: bool = False
    time_s: float = 0.0
    variables: Mapping[str, Any] = field(default_factory=dict)
    slots: Mapping[str, list[Mapping[str, Any]]] = field(default_factory=dict)
    signals: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    unsaved: tuple[str, ...] = ()
    gone: Mapping[str, tuple[str, ErrorReport]] = field(default_factory=dict)
    records: tuple[StepRecord, ...] = ()
    starts: tuple[StartReport, ...] = ()
    continued_s: tuple[float, ...] = ()
    since: tuple[Mapping[str, Any], ...] = ()

    def require_safe(self, scenario: Scenario) -> None:
        """Raise ScenarioError if the scenario has changed, or forbids to repeat the step of the interruption."""
        if scenario_hash(scenario) != self.started["scenario_hash"]:
            raise ScenarioError(
                f"{scenario.source} has changed since the run in {self.directory} began; start a new run"
            )
        file = scenario.file
        if self.first_step >= len(file.steps):
            return
        step = file.steps[self.first_step]
        if self.was_begun and file.is_safe(self.first_step) is False:
            place = scenario.tree.mark_at(("steps", self.first_step))
            raise ScenarioError(
                f"the run in {self.directory} was interrupted in steps[{self.first_step}] ({step.kind}, "
                f"{place.file}:{place.line}), which is not safe_to_repeat"
            )


def read_run(directory: Path) -> Resumption:
    """Read an interrupted run; raise ScenarioError if there is none, it has ended, or it cannot be resumed."""
    if (directory / SUMMARY).exists():
        raise ScenarioError(f"the run in {directory} has ended; only an interrupted run can be resumed")
    try:
        events = read_events(directory / EVENTS)
    except OSError as error:
        raise ScenarioError(f"{directory} has no record of a run: {error.strerror}") from error
    if not events or events[0]["event"] != RunStarted.kind:
        raise ScenarioError(f"{directory / EVENTS} does not begin with the event run_started")
    return _gather(directory, events)


def _gather(directory: Path, events: list[dict[str, Any]]) -> Resumption:
    checkpoint: Mapping[str, Any] = {}
    since: list[Mapping[str, Any]] = []
    for event in events:
        since.append(event)
        if event["event"] == "checkpoint":
            checkpoint, since = event, []
        elif event["event"] == "run_ended":
            raise ScenarioError(f"the run in {directory} has ended; only an interrupted run can be resumed")
    if not checkpoint:
        raise ScenarioError(f"the run in {directory} cannot be resumed: none of its steps is safe_to_repeat")
    return Resumption(
        directory=directory,
        started=events[0],
        first_step=checkpoint["next_step"],
        was_begun=any(event["event"] in ("step_started", "signal") for event in since),
        since=tuple(since),
        time_s=events[-1]["time_s"],
        variables=checkpoint["variables"],
        slots=checkpoint["seats"],
        signals=checkpoint["signals"],
        unsaved=tuple(checkpoint["unsaved"]),
        gone={
            event["robot"]: (event["event"].removeprefix("robot_"), ErrorReport.model_validate(event["error"]))
            for event in events
            if event["event"] in ("robot_dropped", "robot_replaced")
        },
        records=tuple(_records(events)),
        starts=tuple(StartReport.model_validate(event["start"]) for event in _only("started_together", events)),
        continued_s=tuple(event["time_s"] for event in _only("run_continued", events)),
    )


def _records(events: Iterable[dict[str, Any]]) -> Iterator[StepRecord]:
    """Yield the steps in the order of their ends; an interruption ends all steps under way."""
    under_way: dict[tuple[str | None, str], dict[str, Any]] = {}
    time_s = 0.0
    for event in events:
        match event["event"]:
            case "step_started":
                under_way[event["robot"], event["step"]] = event
            case "step_ended":
                record = StepRecord.model_validate(event["record"])
                under_way.pop((record.robot, record.step), None)
                yield record
            case "run_continued":
                yield from _cut_off(under_way.values(), time_s)
                under_way.clear()
        time_s = event["time_s"]
    yield from _cut_off(under_way.values(), time_s)


def _cut_off(started: Iterable[dict[str, Any]], time_s: float) -> Iterator[StepRecord]:
    for event in started:
        fields = {key: event.get(key) for key in ("robot", "role", "step", "branch", "label", "resource", "command")}
        yield StepRecord.model_validate(
            {
                **fields,
                "kind": event.get("step_kind", ""),
                "start_s": event["time_s"],
                "end_s": time_s,
                "outcome": "aborted",
                "attempts": 1,
                "error": {"code": EALError.code, "message": "the controller died"},
            }
        )


def _only(kind: str, events: Iterable[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    return (event for event in events if event["event"] == kind)
