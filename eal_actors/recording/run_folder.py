"""The folder of a run: made for a new run, and read back by the report, the comparison and the replay."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import ScenarioError, error_text, file_error
from eal_actors.recording.mcap_file import RECORD_FILE, McapContent, read_mcap
from eal_actors.recording.poses import PoseSample
from eal_actors.scenario.report.events import read_events
from eal_actors.scenario.report.journal import EVENTS, SUMMARY
from eal_actors.scenario.report.summary import Report

TRAJECTORY: Final = "trajectory.csv"


def new_run_folder(runs_dir: Path, scenario: str) -> Path:
    """Make a new folder named after the scenario and the time; raise ConfigError if it cannot be made."""
    name = f"{scenario}-{wall_time():%Y%m%dT%H%M%SZ}"
    number = 1
    while True:
        directory = runs_dir / (name if number == 1 else f"{name}-{number}")
        try:
            directory.mkdir(parents=True)
        except OSError as error:
            is_taken = isinstance(error, FileExistsError) and directory.exists()  # else a parent is a link to nothing
            if not is_taken:
                raise file_error(error.filename or directory, f"cannot be made: {error.strerror}") from error
            number += 1
        else:
            return directory


@contextmanager
def folder_errors(directory: Path) -> Iterator[None]:
    """Raise ScenarioError, which names the folder, for an OSError such as a full disk."""
    try:
        yield
    except OSError as error:
        raise ScenarioError(f"the folder {directory} cannot be written: {error.strerror or error}") from error


@dataclass(frozen=True)
class RunFolder:
    """The files of a run. Each property raises ScenarioError if its file is broken."""

    path: Path

    @classmethod
    def open(cls, path: Path) -> RunFolder:
        """Return the folder of a run; raise ScenarioError if it is not the folder of a run."""
        if not (path / EVENTS).is_file():
            reason = "there is no such folder" if not path.is_dir() else f"it has no {EVENTS}"
            raise ScenarioError(f"{path} is no folder of a run: {reason}")
        return cls(path)

    @cached_property
    def summary(self) -> Report | None:
        """The summary; None if the controller crashed before the end."""
        file = self.path / SUMMARY
        if not file.is_file():
            return None
        try:
            return Report.model_validate_json(file.read_text(encoding="utf-8"))
        except (ValidationError, ValueError) as error:
            raise ScenarioError(f"{file} is no summary of a run: {error_text(error)}") from error

    @cached_property
    def events(self) -> tuple[dict[str, Any], ...]:
        """The events in their order, without a last line that a crash cut off."""
        return tuple(read_events(self.path / EVENTS))

    @cached_property
    def paths(self) -> dict[str, list[PoseSample]]:
        """The poses of each robot with a Pose, without a last line that a crash cut off."""
        file = self.path / TRAJECTORY
        found: dict[str, list[PoseSample]] = {}
        if not file.is_file():
            return found
        rows = csv.DictReader(file.read_text(encoding="utf-8", errors="replace").split("\n")[:-1])
        try:
            for row in rows:
                sample = PoseSample(*(float(row[name]) for name in PoseSample._fields))
                if not all(map(math.isfinite, sample)):
                    raise ValueError("its numbers must be finite")
                found.setdefault(row["robot"], []).append(sample)
        except (KeyError, ValueError, TypeError, csv.Error) as error:
            raise ScenarioError(f"{file}:{rows.line_num}: is no table of paths: {error_text(error)}") from error
        return found

    @cached_property
    def breaks_s(self) -> tuple[float, ...]:
        """The times at which the run was resumed, in seconds since its start; usually none."""
        return tuple(event["time_s"] for event in self.events if event["event"] == "run_continued")

    @cached_property
    def record(self) -> McapContent:
        """The content of `run.mcap`.

        Raises:
            ScenarioError: it is missing or broken.
            UnsupportedError: the mcap library is not installed.
        """
        file = self.path / RECORD_FILE
        if not file.is_file():
            raise ScenarioError(f"{self.path} has no {RECORD_FILE}: its run was not recorded")
        return read_mcap(file)
