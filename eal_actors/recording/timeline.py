"""The events of a run as people read them: a time line of bars for each robot, and log entries."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

OF_THE_RUN: Final = "scenario"
"""In place of a robot's name, for what no robot does."""


class LogEntry(NamedTuple):
    """A log line: time, level (`info`, `warning` or `error`), the robot or OF_THE_RUN, and the text."""

    time_s: float
    level: str
    source: str
    text: str


def source_of(entry: Mapping[str, Any]) -> str:
    """Return the robot of an event or a step; OF_THE_RUN if it has none."""
    return entry["robot"] or OF_THE_RUN


def log_entry_of(event: Mapping[str, Any]) -> LogEntry | None:
    """Return the log line of an event of `events.jsonl`; None if the time line shows all of it."""
    time_s = float(event["time_s"])
    match event["event"]:
        case "log":
            return LogEntry(time_s, "info", source_of(event), event["text"])
        case "signal":
            return LogEntry(time_s, "info", source_of(event), f"signal {event['name']}")
        case "step_retried":
            text = f"{event['label']}: attempt {event['attempt']} failed: {event['error']['message']}"
            return LogEntry(time_s, "warning", source_of(event), text)
        case "step_ended" if event["record"]["error"]:
            record = event["record"]
            text = f"{record['label']} {record['outcome']}: {record['error']['message']}"
            return LogEntry(time_s, "error", source_of(record), text)
        case "robot_dropped":
            return LogEntry(time_s, "error", event["robot"], f"dropped: {event['error']['message']}")
        case "robot_lost":
            return LogEntry(time_s, "warning", event["robot"], f"lost: {event['error']['message']}")
        case "robot_returned":
            return LogEntry(time_s, "info", event["robot"], "is back")
        case "robot_replaced":
            text = f"replaced by {event['by']}: {event['error']['message']}"
            return LogEntry(time_s, "warning", source_of(event), text)
        case "run_continued":
            text = f"the run was interrupted here, and resumed at steps[{event['first_step']}]"
            return LogEntry(time_s, "warning", OF_THE_RUN, text)
    return None


class Bar(NamedTuple):
    """One call of a robot, in seconds since the run's start."""

    start_s: float
    end_s: float
    label: str
    step: str
    outcome: str
    error: str


@dataclass(slots=True)
class RunTimeline:
    """The course of a run.

    Attributes:
        bars: the calls of each robot by its name, in the order of their ends.
        losses: when each robot was out of reach, from and to; a robot that did not come back, until the end.
        log: log lines, retries, drops and errors.
        breaks_s: the times at which the run was resumed.
    """

    bars: dict[str, list[Bar]] = field(default_factory=dict)
    losses: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    log: list[LogEntry] = field(default_factory=list)
    breaks_s: list[float] = field(default_factory=list)
    duration_s: float = 0.0

    def rows(self, robot: str) -> list[list[Bar]]:
        """Return a robot's bars in as few rows as possible without overlap: calls may run in parallel."""
        rows: list[list[Bar]] = []
        for bar in sorted(self.bars[robot]):
            for row in rows:
                if row[-1].end_s <= bar.start_s:
                    row.append(bar)
                    break
            else:
                rows.append([bar])
        return rows or [[]]


def timeline_of(events: Iterable[Mapping[str, Any]]) -> RunTimeline:
    """Return the time line of a run's events; a call that never ended lasts until the run was interrupted."""
    line = RunTimeline()
    begun: dict[tuple[str, str], Mapping[str, Any]] = {}
    lost_s: dict[str, float] = {}
    for event in events:
        line.duration_s = max(line.duration_s, float(event["time_s"]))
        match event["event"]:
            case "run_started":
                line.bars = {robot: [] for robot in event["robots"]}
            case "run_continued":
                line.breaks_s.append(line.duration_s)
                _add_unfinished(line, begun)
            case "step_started":
                begun[source_of(event), event["step"]] = event
            case "step_ended":
                record = event["record"]
                begun.pop((source_of(record), record["step"]), None)
                error = record["error"]["message"] if record["error"] else ""
                bar = Bar(record["start_s"], record["end_s"], record["label"], record["step"], record["outcome"], error)
                line.bars.setdefault(source_of(record), []).append(bar)
            case "robot_lost":
                lost_s.setdefault(event["robot"], event["time_s"])
            case "robot_returned":
                begin_s = lost_s.pop(event["robot"], event["time_s"])
                line.losses.setdefault(event["robot"], []).append((begin_s, event["time_s"]))
        if (entry := log_entry_of(event)) is not None:
            line.log.append(entry)
    _add_unfinished(line, begun)
    for robot, begin_s in lost_s.items():
        line.losses.setdefault(robot, []).append((begin_s, line.duration_s))
    return line


def _add_unfinished(line: RunTimeline, begun: dict[tuple[str, str], Mapping[str, Any]]) -> None:
    for (robot, step), event in begun.items():
        bar = Bar(event["time_s"], line.duration_s, event["label"], step, "unfinished", "")
        line.bars.setdefault(robot, []).append(bar)
    begun.clear()
