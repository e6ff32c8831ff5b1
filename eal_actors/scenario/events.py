"""What listeners hear of a run, and what `events.jsonl` holds: one event a line, in the order in which they happen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from eal_actors.scenario.report import ErrorReport, Report, StepRecord


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
        return {"event": self.kind, "time_s": self.time_s, **self._fields()}

    def _fields(self) -> dict[str, Any]:
        return {}


@dataclass(frozen=True, slots=True)
class RunStarted(Event):
    """The run begins.

    Attributes:
        scenario: the scenario's name.
        fleet: the fleet's name.
        robots: the robots bound, those lost from the start included.
        calls: how many calls the steps make when nothing fails.
    """

    kind = "run_started"
    scenario: str
    fleet: str
    robots: tuple[str, ...]
    calls: int

    def _fields(self) -> dict[str, Any]:
        return {"scenario": self.scenario, "fleet": self.fleet, "robots": list(self.robots), "calls": self.calls}


@dataclass(frozen=True, slots=True)
class StepStarted(Event):
    """A robot begins a call.

    Attributes:
        robot: the robot's name.
        step: path of the step in the scenario file.
        label: what it does.
    """

    kind = "step_started"
    robot: str
    step: str
    label: str

    def _fields(self) -> dict[str, Any]:
        return {"robot": self.robot, "step": self.step, "label": self.label}


@dataclass(frozen=True, slots=True)
class StepRetried(Event):
    """An attempt at a call failed, and another is due after the back-off.

    Attributes:
        robot: the robot's name.
        step: path of the step in the scenario file.
        label: what it does.
        attempt: number of the attempt that failed, from 1.
        error: why it failed.
    """

    kind = "step_retried"
    robot: str
    step: str
    label: str
    attempt: int
    error: ErrorReport

    def _fields(self) -> dict[str, Any]:
        return {
            "robot": self.robot,
            "step": self.step,
            "label": self.label,
            "attempt": self.attempt,
            "error": self.error.model_dump(),
        }


@dataclass(frozen=True, slots=True)
class StepEnded(Event):
    """A call is over.

    Attributes:
        record: how it went.
    """

    kind = "step_ended"
    record: StepRecord

    def _fields(self) -> dict[str, Any]:
        return {"record": self.record.model_dump()}


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

    def _fields(self) -> dict[str, Any]:
        return {"robot": self.robot, "error": self.error.model_dump()}


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

    def _fields(self) -> dict[str, Any]:
        return {"robot": self.robot, "text": self.text}


@dataclass(frozen=True, slots=True)
class RunEnded(Event):
    """The run is over, and everything that moves was halted.

    Attributes:
        report: the whole report; its line in `events.jsonl` leaves out the steps, which have lines of their own, and
            the wall time, so that the events of a run that repeats are the same.
    """

    kind = "run_ended"
    report: Report

    def _fields(self) -> dict[str, Any]:
        return {"report": self.report.model_dump(exclude={"steps", "started"})}
