"""The events of a run, for listeners and for `events.jsonl`: one event a line, in the order in which they happen."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Final

from pydantic import TypeAdapter, ValidationError
from pydantic_core import to_jsonable_python
from typing_extensions import override

from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.strict_model import wording_of
from eal_actors.scenario.report.records import is_recordable, to_record
from eal_actors.scenario.report.summary import ErrorReport, Report, StartReport, StepRecord


@dataclass(frozen=True, slots=True)
class RunEvent:
    """An event of a run. `time_s` is the seconds since the run's start, of the fleet's clock."""

    kind: ClassVar[str] = "event"
    time_s: float

    def __init_subclass__(cls, *, kind: str = "") -> None:
        if kind:  # `slots` makes each class a second time, without it
            cls.kind = kind

    def to_dict(self) -> dict[str, Any]:
        """Return plain dicts, lists, strings and numbers, with the kind under `event`."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {"event": self.kind, **to_jsonable_python(values)}


@dataclass(frozen=True, slots=True)
class RunStarted(RunEvent, kind="run_started"):
    """The run has begun.

    Attributes:
        scenario_hash: SHA-256 of the content of the scenario and its parts, in hexadecimal.
        rate: seconds of the fleet's clock in one real second, or `max`.
        spares: the robots kept in reserve for each role.
        robots: the robots bound, those lost from the start and spares included.
        calls: number of calls if nothing fails, as far as it is known before the run.
    """

    scenario: str
    scenario_file: str
    scenario_hash: str
    fleet: str
    fleet_file: str
    seed: int
    rate: float | str
    parameters: Mapping[str, object]
    roles: Mapping[str, tuple[str, ...]]
    spares: Mapping[str, tuple[str, ...]]
    robots: tuple[str, ...]
    calls: int


@dataclass(frozen=True, slots=True)
class RunContinued(RunEvent, kind="run_continued"):
    """An interrupted run was resumed, at a wall time in UTC, ISO 8601; other fields are as in RunStarted."""

    first_step: int
    wall_continued: str
    scenario: str
    fleet: str
    robots: tuple[str, ...]
    calls: int


@dataclass(frozen=True, slots=True)
class Checkpoint(RunEvent, kind="checkpoint"):
    """A step of the top level has ended; the state of the run after it.

    Attributes:
        seats: by role, the robot of each slot and the variables of the slot.
        signals: by name, how often each was given, and its last value.
        unsaved: variables whose values have no form in the record.
    """

    next_step: int
    variables: Mapping[str, Any]
    seats: Mapping[str, tuple[Mapping[str, Any], ...]]
    signals: Mapping[str, Mapping[str, Any]]
    unsaved: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class StepStarted(RunEvent, kind="step_started"):
    """A step has begun. Blocks and instant steps have no events.

    Without a robot it is outside of `on`; `step` is its path in the scenario file, `branch` the innermost of a
    `parallel` around it.
    """

    robot: str | None
    step: str
    label: str
    role: str | None = None
    branch: str | None = None
    step_kind: str = ""
    resource: str | None = None
    command: str | None = None


@dataclass(frozen=True, slots=True)
class StepRetried(RunEvent, kind="step_retried"):
    """An attempt at a step, counted from 1, has failed, and another follows after the back-off."""

    robot: str | None
    step: str
    label: str
    attempt: int
    error: ErrorReport


@dataclass(frozen=True, slots=True)
class StepEnded(RunEvent, kind="step_ended"):
    """A step has ended, and has assigned these variables.

    The answer of a call, an EALData, a status int, or None, is for listeners: `events.jsonl` leaves it out, because
    camera frames are large.
    """

    record: StepRecord
    answer: object = None
    variables: Mapping[str, object] = field(default_factory=dict)

    @override
    def to_dict(self) -> dict[str, Any]:
        found: dict[str, Any] = {
            "event": self.kind,
            "time_s": self.time_s,
            "record": self.record.model_dump(mode="json"),
        }
        if self.variables:
            kept = {name: to_record(value) for name, value in self.variables.items() if is_recordable(value)}
            found |= {"variables": kept, "unsaved": len(kept) < len(self.variables)}
        return found


@dataclass(frozen=True, slots=True)
class Readings(RunEvent, kind="readings"):
    """Values were read for a condition, a loop or a variable; a resumed run takes the same way."""

    robot: str
    step: str
    values: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class StartedTogether(RunEvent, kind="started_together"):
    """All robots of a synchronized start have ended the step."""

    start: StartReport


@dataclass(frozen=True, slots=True)
class Signalled(RunEvent, kind="signal"):
    """A signal was given."""

    robot: str | None
    name: str
    count: int
    value: Any


@dataclass(frozen=True, slots=True)
class RobotDropped(RunEvent, kind="robot_dropped"):
    """The run continues without a robot."""

    robot: str
    error: ErrorReport


@dataclass(frozen=True, slots=True)
class RobotReplaced(RunEvent, kind="robot_replaced"):
    """A spare, `by`, has replaced a robot, which leaves."""

    robot: str
    by: str
    role: str
    error: ErrorReport


@dataclass(frozen=True, slots=True)
class RobotLost(RunEvent, kind="robot_lost"):
    """A robot is out of reach."""

    robot: str
    error: ErrorReport


@dataclass(frozen=True, slots=True)
class RobotReturned(RunEvent, kind="robot_returned"):
    """A lost robot is back."""

    robot: str


@dataclass(frozen=True, slots=True)
class LogLine(RunEvent, kind="log"):
    """A line of text for those who watch the run."""

    robot: str | None
    text: str


@dataclass(frozen=True, slots=True)
class RunPaused(RunEvent, kind="run_paused"):
    """The run is paused: no step begins; those under way continue."""


@dataclass(frozen=True, slots=True)
class RunResumed(RunEvent, kind="run_resumed"):
    """The run continues after a pause; with `is_single_step` each robot may begin one step before the next pause."""

    is_single_step: bool


@dataclass(frozen=True, slots=True)
class RunEnded(RunEvent, kind="run_ended"):
    """The run has ended, and all actuators were halted.

    The line of the report in `events.jsonl` leaves out the steps and starts, which have lines of their own, and the
    wall time, so that the events of a run that repeats are the same.
    """

    report: Report

    @override
    def to_dict(self) -> dict[str, Any]:
        report = self.report.model_dump(mode="json", exclude={"steps", "starts", "wall_started"})
        return {"event": self.kind, "time_s": self.time_s, "report": report}


_RECORDED: Final = {one.kind: one for one in RunEvent.__subclasses__() if one.kind != RunEnded.kind}
"""The events whose lines have all their fields."""


@cache
def _checker(kind: str) -> TypeAdapter[RunEvent]:
    return TypeAdapter(_RECORDED[kind])


def read_events(file: Path) -> list[dict[str, Any]]:
    """Return the events of a record, without a last line that a crash cut off.

    Raises:
        OSError: the file cannot be read.
        ScenarioError: a line is no event.
    """
    lines = file.read_text(encoding="utf-8", errors="replace").split("\n")
    return [_read(line, f"{file}:{number}") for number, line in enumerate(lines[:-1], 1)]


def _read(line: str, place: str) -> dict[str, Any]:
    try:
        event = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{place}: is no event: {error}") from error
    event = event if isinstance(event, dict) else {}
    if (problem := _problem(event)) is not None:
        raise ScenarioError(f"{place}: is no event: {problem}")
    return event


def _problem(event: Mapping[str, Any]) -> str | None:
    """Return why an event cannot be read: the first field that is missing or wrong; else None."""
    if not isinstance(event.get("event"), str) or not _is_time(event.get("time_s")):
        return "it needs 'event' and 'time_s', a number"
    try:
        if event["event"] in _RECORDED:  # other releases have other kinds
            _checker(event["event"]).validate_python(event)
    except ValidationError as error:
        detail = error.errors(include_url=False)[0]
        return f"{event['event']}: {'.'.join(map(str, detail['loc']))}: {wording_of(detail)}"
    return None


def _is_time(value: object) -> bool:
    return isinstance(value, int | float) and abs(value) <= sys.float_info.max
