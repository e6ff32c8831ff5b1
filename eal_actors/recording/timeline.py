"""Who did what when: a run's events as one row of bars for each robot."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from eal_actors.recording.notes import Note, note_of, whose


class Bar(NamedTuple):
    """One call of a robot, from its begin to its end, in seconds since the run's start."""

    start_s: float
    end_s: float
    label: str
    step: str
    outcome: str
    error: str


@dataclass(slots=True)
class TimeLine:
    """A run, as it went.

    Attributes:
        bars: the calls of each robot, by its name, in the order of their ends.
        notes: log lines, retries, drops and errors.
        breaks_s: when the run was cut off and went on.
        duration_s: until the last event.
    """

    bars: dict[str, list[Bar]] = field(default_factory=dict)
    notes: list[Note] = field(default_factory=list)
    breaks_s: list[float] = field(default_factory=list)
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
    """Return the time line of a run's events; calls that never ended last until the run was cut off."""
    line = TimeLine()
    begun: dict[tuple[str, str], Mapping[str, Any]] = {}
    for event in events:
        line.duration_s = max(line.duration_s, float(event["time_s"]))
        match event["event"]:
            case "run_started":
                line.bars = {robot: [] for robot in event["robots"]}
            case "run_continued":
                line.breaks_s.append(line.duration_s)
                _add_unfinished(line, begun)
            case "step_started":
                begun[whose(event), event["step"]] = event
            case "step_ended":
                record = event["record"]
                begun.pop((whose(record), record["step"]), None)
                _add(line, record)
        if (note := note_of(event)) is not None:
            line.notes.append(note)
    _add_unfinished(line, begun)
    return line


def _add(line: TimeLine, record: Mapping[str, Any]) -> None:
    error = record["error"]["message"] if record["error"] else ""
    bar = Bar(record["start_s"], record["end_s"], record["label"], record["step"], record["outcome"], error)
    line.bars.setdefault(whose(record), []).append(bar)


def _add_unfinished(line: TimeLine, begun: dict[tuple[str, str], Mapping[str, Any]]) -> None:
    """Add what was under way when the run was cut off."""
    for (robot, step), event in begun.items():
        bar = Bar(event["time_s"], line.duration_s, event["label"], step, "unfinished", "")
        line.bars.setdefault(robot, []).append(bar)
    begun.clear()
