"""Folder of a sweep: its finished runs, and the inputs that they were made from."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from eal_actors.kernel import posix
from eal_actors.kernel.errors import ScenarioError, writing
from eal_actors.lab.sweeping.results import SweepResult, read_result
from eal_actors.lab.sweeping.sweep import Sweep, SweepJob
from eal_actors.recording import RunFolder, keep_provenance
from eal_actors.scenario import Scenario
from eal_actors.scenario.report.journal import SUMMARY

SETTINGS: Final = "sweep.json"
LOG: Final = "workers.log"
_RUNS: Final = "runs"
_LOCK: Final = ".lock"


class SweepFolder:
    """The folder of a sweep."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @contextmanager
    def open(self, sweep: Sweep, *, repeat: bool) -> Iterator[None]:
        """Lock the folder for a sweep during the `with` block. `repeat` removes the finished runs.

        Raises:
            ConfigError: the folder cannot be written.
            ScenarioError: the folder is not a sweep's, or its scenario or fleet differs, or another process uses it.
        """
        settings = self.path / SETTINGS
        with writing(self.path):
            if self.path.exists() and not settings.is_file() and any(self.path.iterdir()):
                raise ScenarioError(f"{self.path} is not the folder of a sweep; choose another one with --out")
            (self.path / _RUNS).mkdir(parents=True, exist_ok=True)
            lock = (self.path / _LOCK).open("w")
        with lock:
            try:
                posix.lock(lock)
            except BlockingIOError:
                raise ScenarioError(f"another sweep uses {self.path}; choose another folder with --out") from None
            with writing(self.path):
                if repeat:
                    shutil.rmtree(self.path / _RUNS)
                    (self.path / _RUNS).mkdir()
                elif settings.is_file():
                    self._require_same(sweep, json.loads(settings.read_text(encoding="utf-8")))
                self._write_settings(sweep)
            yield

    @property
    def logged_bytes(self) -> int:
        """Size of the workers' log."""
        log = self.path / LOG
        return log.stat().st_size if log.is_file() else 0

    def directory_of(self, job: SweepJob) -> Path:
        """Return the folder of a run."""
        return self.path / _RUNS / job.name

    def is_finished(self, job: SweepJob) -> bool:
        """Return whether a run is finished."""
        return (self.directory_of(job) / SUMMARY).is_file()

    def clear(self, job: SweepJob) -> Path:
        """Remove the files of an interrupted run; return its folder."""
        directory = self.directory_of(job)
        if directory.exists():
            shutil.rmtree(directory)
        return directory

    def result(self, job: SweepJob, scenario: Scenario) -> SweepResult:
        """Return the result of a finished run; raise ScenarioError if the run's record is broken."""
        return read_result(job, RunFolder.open(self.directory_of(job)), scenario)

    def _require_same(self, sweep: Sweep, before: dict[str, Any]) -> None:
        changed = [
            str(file)
            for key, file, now in (
                ("scenario_hash", sweep.scenario.source, sweep.scenario_hash),
                (
                    "fleet_hash",
                    f"{sweep.fleet.source} (or its world, its map, its Python steps, or this release)",
                    sweep.fleet_hash,
                ),
            )
            if before.get(key) != now
        ]
        if changed:
            raise ScenarioError(
                f"{' and '.join(changed)} has changed since the runs in {self.path}: "
                "run all of them again with --repeat, or choose another folder with --out"
            )

    def _write_settings(self, sweep: Sweep) -> None:
        settings = {
            "version": 1,
            "scenario": str(sweep.scenario.source),
            "scenario_hash": sweep.scenario_hash,
            "fleet": str(sweep.fleet.source),
            "fleet_hash": sweep.fleet_hash,
            "vary": {variation.name: list(variation.values) for variation in sweep.variations},
            "seeds": list(sweep.seeds),
        }
        keep_provenance(self.path, sweep.fleet, sweep.scenario)
        unfinished = self.path / f"{SETTINGS}.tmp"
        unfinished.write_text(json.dumps(settings, indent=2) + "\n", encoding="utf-8")
        unfinished.replace(self.path / SETTINGS)
