"""Who did what when: a run's events as one row of bars for each robot."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

OF_THE_RUN: Final = "scenario"
"""Stands where a robot's name does, for what no robot does by itself."""


class Bar(NamedTuple):
    """One call of a robot, from its begin to its end, in seconds since the run's start."""

    start_s: float
    end_s: float
    label: str
    step: str
    outcome: str
    error: str


class Note(NamedTuple):
    """A line for people: when, how grave (`info`, `warning` or `error`), whose, and the text."""

    time_s: float
    level: str
    whose: str
    text: str


@dataclass(slots=True)
class TimeLine:
    """A run, as it went.

    Attributes:
        bars: the calls of each robot, by its name, in the order of their ends.
        notes: log lines, retries, drops and errors.
        duration_s: until the last event.
    """

    bars: dict[str, list[Bar]] = field(default_factory=dict)
    notes: list[Note] = field(default_factory=list)
    duration_s: float = 0.0

    def lanes(self, robot: str) -> list[list[Bar]]:
        """Return a robot's bars on as few lines as they need not to overlap: calls may run side by side."""
        lanes: list[list[Bar]] = []
        for bar in sorted(self.bars[robot]):
            for lane in lanes:
                if lane[-1].end_s <= bar.start_s:
                    lane.append(bar)
                    break
            else:
                lanes.append([bar])
        return lanes or [[]]


def time_lines(events: Iterable[Mapping[str, Any]]) -> TimeLine:
    """Return the time line of a run's events; calls that never ended last until the last event."""
    line = TimeLine()
    begun: dict[tuple[str, str], Mapping[str, Any]] = {}
    for event in events:
        line.duration_s = max(line.duration_s, float(event["time_s"]))
        match event["event"]:
            case "run_started":
                line.bars = {robot: [] for robot in event["robots"]}
            case "step_started":
                begun[_whose(event), event["step"]] = event
            case "step_ended":
                record = event["record"]
                begun.pop((_whose(record), record["step"]), None)
                _add(line, record)
            case _:
                _note(line, event)
    for (robot, step), event in begun.items():
        bar = Bar(event["time_s"], line.duration_s, event["label"], step, "unfinished", "")
        line.bars.setdefault(robot, []).append(bar)
    return line


def _whose(entry: Mapping[str, Any]) -> str:
    """Return the robot, or who stands for what none of them does."""
    return entry["robot"] or OF_THE_RUN


def _add(line: TimeLine, record: Mapping[str, Any]) -> None:
    error = record["error"]["message"] if record["error"] else ""
    bar = Bar(record["start_s"], record["end_s"], record["label"], record["step"], record["outcome"], error)
    line.bars.setdefault(_whose(record), []).append(bar)
    if error:
        text = f"{record['label']} {record['outcome']}: {error}"
        line.notes.append(Note(record["end_s"], "error", _whose(record), text))


def _note(line: TimeLine, event: Mapping[str, Any]) -> None:
    match event["event"]:
        case "log":
            line.notes.append(Note(event["time_s"], "info", _whose(event), event["text"]))
        case "step_retried":
            text = f"{event['label']}: attempt {event['attempt']} failed: {event['error']['message']}"
            line.notes.append(Note(event["time_s"], "warning", _whose(event), text))
        case "robot_replaced":
            text = f"{event['by']} takes its place: {event['error']['message']}"
            line.notes.append(Note(event["time_s"], "warning", _whose(event), text))
        case "signal":
            line.notes.append(Note(event["time_s"], "info", _whose(event), f"signal {event['name']}"))
        case "robot_dropped":
            line.notes.append(Note(event["time_s"], "error", event["robot"], f"dropped: {event['error']['message']}"))
