"""What people should read of a run's events: for the report page, and for the log of `run.mcap`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

OF_THE_RUN: Final = "scenario"
"""Stands where a robot's name does, for what no robot does by itself."""


class Note(NamedTuple):
    """A line for people: when, how grave (`info`, `warning` or `error`), whose, and the text."""

    time_s: float
    level: str
    whose: str
    text: str


def whose(entry: Mapping[str, Any]) -> str:
    """Return the robot of an event or a step, or who stands for what none of them does."""
    return entry["robot"] or OF_THE_RUN


def note_of(event: Mapping[str, Any]) -> Note | None:
    """Return what an event, as `events.jsonl` has it, tells people; None for nothing beside the time lines."""
    time_s = float(event["time_s"])
    match event["event"]:
        case "log":
            return Note(time_s, "info", whose(event), event["text"])
        case "signal":
            return Note(time_s, "info", whose(event), f"signal {event['name']}")
        case "step_retried":
            text = f"{event['label']}: attempt {event['attempt']} failed: {event['error']['message']}"
            return Note(time_s, "warning", whose(event), text)
        case "step_ended" if event["record"]["error"]:
            record = event["record"]
            text = f"{record['label']} {record['outcome']}: {record['error']['message']}"
            return Note(time_s, "error", whose(record), text)
        case "robot_dropped":
            return Note(time_s, "error", event["robot"], f"dropped: {event['error']['message']}")
        case "robot_replaced":
            text = f"{event['by']} takes its place: {event['error']['message']}"
            return Note(time_s, "warning", whose(event), text)
        case "run_continued":
            text = f"the run was cut off here, and goes on at steps[{event['first_step']}]"
            return Note(time_s, "warning", OF_THE_RUN, text)
    return None
