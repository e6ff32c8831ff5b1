"""The progress of the newest run on this machine, by the events in its folder."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any


@dataclass(slots=True)
class RunProgress:
    """The progress of a run.

    Attributes:
        calls: the number of calls if nothing fails, as far as it was known at the start.
        steps: the current steps by robot; "" stands for the run itself.
        outcome: the outcome; None while the run is active.
    """

    scenario: str
    fleet: str
    calls: int
    done: int = 0
    failed: int = 0
    steps: dict[str, str] = field(default_factory=dict)
    outcome: str | None = None

    def apply(self, event: dict[str, Any]) -> None:
        """Apply an event after the start."""
        match event.get("event"):
            case "run_continued":
                self.outcome = None
            case "step_started":
                self.steps[event["robot"] or ""] = event["label"]
            case "step_ended":
                record = event["record"]
                self.done += record["resource"] is not None
                self.failed += record["outcome"] == "failed"
                self.steps.pop(record["robot"] or "", None)
            case "run_ended":
                self.outcome = event["report"]["outcome"]
                self.steps.clear()


def latest_run(runs_dir: Path, fleet: str) -> RunProgress | None:
    """Return the progress of the newest run of a fleet; None if there is none. Skips unreadable files."""
    try:
        files = sorted(runs_dir.glob("*/events.jsonl"), key=lambda file: file.stat().st_mtime, reverse=True)
    except OSError:  # a folder has just been removed
        return None
    for file in files:
        try:
            with file.open(encoding="utf-8", errors="replace") as lines:
                first = progress_of(islice(lines, 1))  # without the other lines of all runs of other fleets
                if first is not None and first.fleet == fleet:
                    return progress_of(lines, first)
        except (OSError, AttributeError, KeyError, TypeError):  # of a damaged file
            continue
    return None


def progress_of(lines: Iterable[str], progress: RunProgress | None = None) -> RunProgress | None:
    """Return the progress by a run's events, or further ones; None without a start. The last line may be incomplete.

    Raises AttributeError, KeyError or TypeError if a line is no event.
    """
    for line in lines:
        try:
            event = json.loads(line)
        except ValueError:
            continue
        if event.get("event") == "run_started":
            progress = RunProgress(event["scenario"], event["fleet"], event["calls"])
        elif progress is not None:
            progress.apply(event)
    return progress
