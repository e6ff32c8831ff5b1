"""What listeners hear of a run, and what `events.jsonl` holds: one event a line, in the order in which they happen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from pydantic import BaseModel

from eal_actors.scenario.report import ErrorReport, Report, StartReport, StepRecord


@dataclass(frozen=True, slots=True)
class Event:
    """Something happened.

    Attributes:
        time_s: seconds since the run's start, of the fleet's clock.
    """

    kind: ClassVar[str] = "event"
    time_s: float

    def to_dict(self) -> dict[str, Any]:
        """Return plain dicts, lists, strings and numbers, with the kind under `event`."""
        return {"event": self.kind, **{field.name: _plain(getattr(self, field.name)) for field in fields(self)}}


def _plain(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    return value


@dataclass(frozen=True, slots=True)
class RunStarted(Event):
    """The run begins.

    Attributes:
        scenario: the scenario's name.
        scenario_file: its file, as it was given.
        scenario_hash: SHA-256 of what the scenario says, its parts included, in hexadecimal.
        fleet: the fleet's name.
        fleet_file: its file, as it was given.
        seed: where all randomness starts from.
        rate: seconds of the fleet's clock in one real second, or `max`.
        parameters: the values of the scenario's parameters.
        roles: the robots of each role.
        spares: the robots kept in reserve for each role.
        robots: the robots bound, those lost from the start and spares included.
        calls: how many calls the steps make when nothing fails; where that depends on readings, as far as is known.
    """

    kind = "run_started"
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
class RunContinued(Event):
    """A run that was cut off goes on.

    Attributes:
        first_step: number of the top-level step at which it goes on, from 0.
        wall_continued: wall time in UTC, ISO 8601.
        scenario, fleet, robots, calls: as in RunStarted.
    """

    kind = "run_continued"
    first_step: int
    wall_continued: str
    scenario: str
    fleet: str
    robots: tuple[str, ...]
    calls: int


@dataclass(frozen=True, slots=True)
class Checkpoint(Event):
    """A step of the top level has ended, and this is how things stand.

    Attributes:
        next_step: number of the step that comes next, from 0.
        variables: those of the run, by name.
        seats: by role, who sits where, and the variables of that place.
        signals: by name, how often each was given, and its newest value.
        unsaved: variables whose values do not go into the record.
    """

    kind = "checkpoint"
    next_step: int
    variables: Mapping[str, Any]
    seats: Mapping[str, tuple[Mapping[str, Any], ...]]
    signals: Mapping[str, Mapping[str, Any]]
    unsaved: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class StepStarted(Event):
    """A step begins: a call, a wait, a meeting, an expectation or a function; blocks and instant steps have no events.

    Attributes:
        robot: the robot's name; None outside of `on`.
        step: path of the step in the scenario file.
        label: what it does.
        role: the robot's role in it.
        branch: the innermost branch of a `parallel` around it.
        step_kind: the key that tells what the step is.
        resource: for calls.
        command: what a call was given as text.
    """

    kind = "step_started"
    robot: str | None
    step: str
    label: str
    role: str | None = None
    branch: str | None = None
    step_kind: str = ""
    resource: str | None = None
    command: str | None = None


@dataclass(frozen=True, slots=True)
class StepRetried(Event):
    """An attempt at a step failed, and another is due after the back-off.

    Attributes:
        robot: the robot's name; None outside of `on`.
        step: path of the step in the scenario file.
        label: what it does.
        attempt: number of the attempt that failed, from 1.
        error: why it failed.
    """

    kind = "step_retried"
    robot: str | None
    step: str
    label: str
    attempt: int
    error: ErrorReport


@dataclass(frozen=True, slots=True)
class StepEnded(Event):
    """A step is over.

    Attributes:
        record: how it went.
        answer: what a call answered, for listeners: an EALData, a status int, or None. It is not in the line of
            `events.jsonl`, which frames would swell.
    """

    kind = "step_ended"
    record: StepRecord
    answer: object = None

    def to_dict(self) -> dict[str, Any]:
        """See Event."""
        return {"event": self.kind, "time_s": self.time_s, "record": self.record.model_dump(mode="json")}


@dataclass(frozen=True, slots=True)
class StartedTogether(Event):
    """All robots that were to begin a step together have ended it.

    Attributes:
        start: how close together they began.
    """

    kind = "started_together"
    start: StartReport


@dataclass(frozen=True, slots=True)
class Signalled(Event):
    """A signal was given.

    Attributes:
        robot: who gave it; None outside of `on`.
        name: the signal.
        count: how often it was given so far.
        value: what came with it.
    """

    kind = "signal"
    robot: str | None
    name: str
    count: int
    value: Any


@dataclass(frozen=True, slots=True)
class RobotDropped(Event):
    """The run goes on without a robot.

    Attributes:
        robot: the robot's name.
        error: why.
    """

    kind = "robot_dropped"
    robot: str
    error: ErrorReport


@dataclass(frozen=True, slots=True)
class RobotReplaced(Event):
    """A spare takes the place of a robot.

    Attributes:
        robot: who leaves.
        by: who takes its place.
        role: in which role.
        error: why.
    """

    kind = "robot_replaced"
    robot: str
    by: str
    role: str
    error: ErrorReport


@dataclass(frozen=True, slots=True)
class LogLine(Event):
    """Text for those who watch.

    Attributes:
        robot: whose branch it comes from; None outside of `on`.
        text: the text.
    """

    kind = "log"
    robot: str | None
    text: str


@dataclass(frozen=True, slots=True)
class RunPaused(Event):
    """Nothing new is begun; what is under way goes on."""

    kind = "run_paused"


@dataclass(frozen=True, slots=True)
class RunResumed(Event):
    """Steps are begun again after a pause.

    Attributes:
        is_single_step: each robot may begin one, and then the run is paused again.
    """

    kind = "run_resumed"
    is_single_step: bool


@dataclass(frozen=True, slots=True)
class RunEnded(Event):
    """The run is over, and everything that moves was halted.

    Attributes:
        report: the whole report; its line in `events.jsonl` leaves out the steps and starts, which have lines of their
            own, and the wall time, so that the events of a run that repeats are the same.
    """

    kind = "run_ended"
    report: Report

    def to_dict(self) -> dict[str, Any]:
        """See Event."""
        report = self.report.model_dump(mode="json", exclude={"steps", "starts", "wall_started"})
        return {"event": self.kind, "time_s": self.time_s, "report": report}
