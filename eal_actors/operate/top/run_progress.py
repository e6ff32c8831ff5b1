"""How far the newest run on this machine has come, by what it writes down as it goes."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True)
class RunProgress:
    """How far a run has come.

    Attributes:
        scenario: the scenario's name.
        fleet: the fleet's name.
        done: how many calls have ended.
        failed: how many steps have failed.
        calls: how many calls the steps make when nothing fails, as far as that was known at the start.
        now: what the robots do now, by their names.
        outcome: what came of it; None while it goes on.
    """

    scenario: str
    fleet: str
    done: int = 0
    failed: int = 0
    calls: int = 0
    now: tuple[tuple[str, str], ...] = ()
    outcome: str | None = None


def latest_run(runs_dir: Path, fleet: str) -> RunProgress | None:
    """Return how far the newest run of a fleet has come; None if there is none. What cannot be read is passed over."""
    try:
        files = sorted(runs_dir.glob("*/events.jsonl"), key=lambda file: file.stat().st_mtime, reverse=True)
    except OSError:  # a folder that was just removed
        return None
    for file in files:
        try:
            with file.open(encoding="utf-8", errors="replace") as lines:
                progress = progress_of(lines)
        except OSError:
            continue
        if progress is not None and progress.fleet == fleet:
            return progress
    return None


def progress_of(lines: Iterable[str]) -> RunProgress | None:
    """Return how far a run has come by its events; None without a start. A last line may be half written."""
    start: dict[str, Any] | None = None
    done = failed = 0
    outcome: str | None = None
    now: dict[str, str] = {}
    for line in lines:
        try:
            event = json.loads(line)
        except ValueError:
            continue
        kind = event.get("event")
        if kind == "run_started":
            start, done, failed, outcome, now = event, 0, 0, None, {}
        elif kind == "run_continued":
            outcome = None
        elif kind == "step_started":
            now[event["robot"] or ""] = event["label"]
        elif kind == "step_ended":
            record = event["record"]
            done += record["resource"] is not None
            failed += record["outcome"] == "failed"
            now.pop(record["robot"] or "", None)
        elif kind == "run_ended":
            outcome, now = event["report"]["outcome"], {}
    if start is None:
        return None
    return RunProgress(
        start["scenario"], start["fleet"], done, failed, start["calls"], tuple(sorted(now.items())), outcome
    )
