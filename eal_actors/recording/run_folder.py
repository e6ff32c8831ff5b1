"""A run's folder, read back: what the report, the comparison and the replay have in common."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from eal_actors.kernel.errors import ScenarioError, error_text
from eal_actors.recording.mcap_file import RECORD_FILE, McapContent, read_mcap
from eal_actors.recording.pose_sample import PoseSample
from eal_actors.scenario.report import Report
from eal_actors.scenario.resuming import EVENTS, SUMMARY

TRAJECTORY: Final = "trajectory.csv"


@dataclass(frozen=True)
class RunFolder:
    """What a run left behind.

    Attributes:
        path: the folder.
    """

    path: Path

    @classmethod
    def open(cls, path: Path) -> RunFolder:
        """Return the folder of a run.

        Raises:
            ScenarioError: it is none.
        """
        if not (path / EVENTS).is_file():
            what = "there is no such folder" if not path.is_dir() else f"it has no {EVENTS}"
            raise ScenarioError(f"{path} is no folder of a run: {what}")
        return cls(path)

    @cached_property
    def summary(self) -> Report | None:
        """The summary; None if the controller crashed before the run was over.

        Raises:
            ScenarioError: it is broken.
        """
        file = self.path / SUMMARY
        if not file.is_file():
            return None
        try:
            return Report.model_validate_json(file.read_text(encoding="utf-8"))
        except (ValidationError, ValueError) as error:
            raise ScenarioError(f"{file} is no summary of a run: {error_text(error)}") from error

    @cached_property
    def events(self) -> tuple[dict[str, Any], ...]:
        """The events in their order; a last line that a crash cut off is left out.

        Raises:
            ScenarioError: a line is broken, with its number.
        """
        file = self.path / EVENTS
        lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
        events: list[dict[str, Any]] = []
        for number, line in enumerate(lines, 1):
            try:
                event = json.loads(line)
            except ValueError as error:
                if number == len(lines):
                    break
                raise ScenarioError(f"{file}:{number}: is no event: {error}") from error
            if not isinstance(event, dict) or not {"event", "time_s"} <= event.keys():
                raise ScenarioError(f"{file}:{number}: is no event: it does not say what happened and when")
            events.append(event)
        return tuple(events)

    @cached_property
    def paths(self) -> dict[str, list[PoseSample]]:
        """Where each robot was; empty if nobody knew. A last line that a crash cut off is left out.

        Raises:
            ScenarioError: the table is broken.
        """
        file = self.path / TRAJECTORY
        found: dict[str, list[PoseSample]] = {}
        if not file.is_file():
            return found
        try:
            whole_lines = file.read_text(encoding="utf-8").split("\n")[:-1]
            for row in csv.DictReader(whole_lines):
                sample = PoseSample(*(float(row[name]) for name in PoseSample._fields))
                found.setdefault(row["robot"], []).append(sample)
        except (KeyError, ValueError, TypeError) as error:
            raise ScenarioError(f"{file} is no table of paths: {error_text(error)}") from error
        return found

    @cached_property
    def breaks_s(self) -> tuple[float, ...]:
        """When the run, which was cut off, went on, in seconds since its start; mostly never.

        Raises:
            ScenarioError: see `events`.
        """
        return tuple(event["time_s"] for event in self.events if event["event"] == "run_continued")

    @cached_property
    def record(self) -> McapContent:
        """What `run.mcap` holds.

        Raises:
            ScenarioError: there is none, or it is broken.
            UnsupportedError: the mcap library is not installed.
        """
        file = self.path / RECORD_FILE
        if not file.is_file():
            raise ScenarioError(f"{self.path} has no {RECORD_FILE}: its run was not recorded")
        return read_mcap(file)
