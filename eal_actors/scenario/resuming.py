"""Reads what a run that was cut off has left behind, so that it can go on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from eal_actors.kernel.errors import EALError, ScenarioError
from eal_actors.scenario.model import ScenarioFile
from eal_actors.scenario.report import ErrorReport, StartReport, StepRecord
from eal_actors.scenario.scenario import Scenario

EVENTS: Final = "events.jsonl"
SUMMARY: Final = "summary.json"


@dataclass(frozen=True, slots=True)
class Resumption:
    """Where a run that was cut off goes on.

    Attributes:
        directory: its folder.
        started: the fields of its event `run_started`.
        first_step: number of the top-level step at which it goes on, from 0.
        was_begun: whether that step had begun.
        time_s: the time of its last event.
        variables: those of the run.
        seats: by role, who sits where, and the variables of the place.
        signals: by name, how often each was given, and its newest value.
        unsaved: variables whose values were not kept.
        gone: robots that take part no more, with their outcome and why.
        records: the steps that were over, and as `aborted` those under way when it was cut off.
        starts: the starts together that were over.
        continued_s: when it went on before, if this is not the first time.
    """

    directory: Path
    started: Mapping[str, Any]
    first_step: int = 0
    was_begun: bool = False
    time_s: float = 0.0
    variables: Mapping[str, Any] = field(default_factory=dict)
    seats: Mapping[str, list[Mapping[str, Any]]] = field(default_factory=dict)
    signals: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    unsaved: tuple[str, ...] = ()
    gone: Mapping[str, tuple[str, ErrorReport]] = field(default_factory=dict)
    records: tuple[StepRecord, ...] = ()
    starts: tuple[StartReport, ...] = ()
    continued_s: tuple[float, ...] = ()

    def require_safe(self, scenario: Scenario) -> None:
        """Refuse to go on with a scenario that has changed, or where it would repeat what must not be repeated.

        Raises:
            ScenarioError: for one of these reasons.
        """
        if scenario_hash(scenario) != self.started["scenario_hash"]:
            raise ScenarioError(
                f"{scenario.source} has changed since the run in {self.directory} began; start a new run"
            )
        file = scenario.file
        if self.first_step >= len(file.steps):
            return
        step = file.steps[self.first_step]
        if self.was_begun and not is_safe(file, self.first_step):
            place = scenario.tree.mark_at(("steps", self.first_step))
            raise ScenarioError(
                f"the run in {self.directory} was cut off in steps[{self.first_step}] ({step.kind}, "
                f"{place.file}:{place.line}), which the scenario does not call safe_to_repeat"
            )


def is_safe(file: ScenarioFile, index: int) -> bool:
    """Return whether a top-level step may be repeated."""
    own = file.steps[index].safe_to_repeat
    return file.safe_to_repeat if own is None else own


def keeps_checkpoints(file: ScenarioFile) -> bool:
    """Return whether a run of a scenario may go on after it was cut off."""
    return any(is_safe(file, index) for index in range(len(file.steps)))


def scenario_hash(scenario: Scenario) -> str:
    """Return the SHA-256 of what a scenario and its parts say, in hexadecimal."""
    digest = hashlib.sha256(scenario.file.model_dump_json().encode())
    for path in sorted(scenario.parts):
        digest.update(f"{path}:{scenario_hash(scenario.parts[path])}".encode())
    return digest.hexdigest()


def read_run(directory: Path) -> Resumption:
    """Read the folder of a run that was cut off.

    Raises:
        ScenarioError: there is no such run, it came to its end, or it cannot go on.
    """
    if (directory / SUMMARY).exists():
        raise ScenarioError(f"the run in {directory} came to its end; only one that was cut off can be resumed")
    try:
        lines = (directory / EVENTS).read_text(encoding="utf-8", errors="replace").split("\n")
    except OSError as error:
        raise ScenarioError(f"{directory} holds no record of a run: {error.strerror}") from error
    events = [_read(line, directory, number) for number, line in enumerate(lines[:-1], 1)]  # the last one was cut off
    if not events or events[0].get("event") != "run_started":
        raise ScenarioError(f"{directory / EVENTS} does not begin as the record of a run does")
    try:
        return _gather(directory, events)
    except (KeyError, TypeError, ValueError, ValidationError) as error:
        raise ScenarioError(
            f"{directory / EVENTS} is not a record that this release can go on from: {error}"
        ) from error


def _read(line: str, directory: Path, number: int) -> dict[str, Any]:
    try:
        event = json.loads(line)
    except ValueError as error:
        raise ScenarioError(f"{directory / EVENTS}:{number}: is no JSON: {error}") from error
    return event if isinstance(event, dict) else {}


def _gather(directory: Path, events: list[dict[str, Any]]) -> Resumption:
    checkpoint: Mapping[str, Any] = {}
    was_begun = False
    for event in events:
        match event["event"]:
            case "checkpoint":
                checkpoint, was_begun = event, False
            case "run_ended":
                raise ScenarioError(f"the run in {directory} came to its end; only one that was cut off can be resumed")
            case "step_started" | "signal":
                was_begun = True
    if not checkpoint:
        raise ScenarioError(
            f"the run in {directory} cannot be resumed: its scenario calls none of its steps safe_to_repeat"
        )
    return Resumption(
        directory=directory,
        started=events[0],
        first_step=checkpoint["next_step"],
        was_begun=was_begun,
        time_s=events[-1]["time_s"],
        variables=checkpoint["variables"],
        seats=checkpoint["seats"],
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
    """Yield the steps in the order of their ends; where the run was cut off, that is the end of all under way."""
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
        told = {key: event.get(key) for key in ("robot", "role", "step", "branch", "label", "resource", "command")}
        yield StepRecord.model_validate(
            {
                **told,
                "kind": event["step_kind"],
                "start_s": event["time_s"],
                "end_s": time_s,
                "outcome": "aborted",
                "attempts": 1,
                "error": {"code": EALError.code, "message": "the controller died"},
            }
        )


def _only(kind: str, events: Iterable[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    return (event for event in events if event["event"] == kind)
