"""The folder of a sweep: the runs that are finished, and what they were made of."""

from __future__ import annotations

import fcntl
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from eal_actors.kernel.errors import ScenarioError
from eal_actors.lab.sweeping.results import Result, read_result
from eal_actors.lab.sweeping.sweep import Job, Sweep
from eal_actors.recording import RunFolder, keep_provenance
from eal_actors.scenario import Scenario
from eal_actors.scenario.report.journal import SUMMARY

ORDER: Final = "sweep.json"
LOG: Final = "workers.log"
_RUNS: Final = "runs"
_LOCK: Final = ".lock"


class SweepFolder:
    """What a sweep leaves behind.

    Args:
        path: the folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @contextmanager
    def open(self, sweep: Sweep, *, repeat: bool) -> Iterator[None]:
        """Take the folder for a sweep; nobody else can until the end of the `with` block.

        Args:
            sweep: the sweep.
            repeat: forget the runs that are finished.

        Raises:
            ScenarioError: it is another's folder, or of another scenario or fleet, or another process is at work in it.
        """
        order = self.path / ORDER
        if self.path.exists() and not order.is_file() and any(self.path.iterdir()):
            raise ScenarioError(f"{self.path} is no folder of a sweep; --out names another one")
        try:
            (self.path / _RUNS).mkdir(parents=True, exist_ok=True)
            lock = (self.path / _LOCK).open("w")
        except OSError as error:
            raise ScenarioError(f"the sweep's folder {self.path} cannot be written: {error}") from error
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ScenarioError(f"another sweep is at work in {self.path}; --out names another folder") from None
            if repeat:
                shutil.rmtree(self.path / _RUNS)
                (self.path / _RUNS).mkdir()
            elif order.is_file():
                self._require_same(sweep, json.loads(order.read_text(encoding="utf-8")))
            self._write_order(sweep)
            yield

    @property
    def logged_bytes(self) -> int:
        """How much the processes have logged so far."""
        log = self.path / LOG
        return log.stat().st_size if log.is_file() else 0

    def directory_of(self, job: Job) -> Path:
        """Return the folder of a run."""
        return self.path / _RUNS / job.name

    def is_finished(self, job: Job) -> bool:
        """Return whether a run has come to its end."""
        return (self.directory_of(job) / SUMMARY).is_file()

    def clear(self, job: Job) -> Path:
        """Remove what a run that was cut off has left behind; return its folder."""
        directory = self.directory_of(job)
        if directory.exists():
            shutil.rmtree(directory)
        return directory

    def result(self, job: Job, scenario: Scenario) -> Result:
        """Return what came of a finished run.

        Raises:
            ScenarioError: its record is broken.
        """
        return read_result(job, RunFolder.open(self.directory_of(job)), scenario)

    def _require_same(self, sweep: Sweep, before: dict[str, Any]) -> None:
        changed = [
            str(file)
            for key, file, now in (
                ("scenario_hash", sweep.scenario.source, sweep.scenario_hash),
                ("fleet_hash", f"{sweep.fleet.source} (or its world, or this release)", sweep.fleet_hash),
            )
            if before.get(key) != now
        ]
        if changed:
            raise ScenarioError(
                f"{' and '.join(changed)} has changed since the runs in {self.path} were made: --repeat runs all of "
                "them again, and --out names another folder"
            )

    def _write_order(self, sweep: Sweep) -> None:
        order = {
            "version": 1,
            "scenario": str(sweep.scenario.source),
            "scenario_hash": sweep.scenario_hash,
            "fleet": str(sweep.fleet.source),
            "fleet_hash": sweep.fleet_hash,
            "vary": {variation.name: list(variation.values) for variation in sweep.variations},
            "seeds": list(sweep.seeds),
        }
        keep_provenance(self.path, sweep.fleet, sweep.scenario)
        unfinished = self.path / f"{ORDER}.tmp"
        unfinished.write_text(json.dumps(order, indent=2) + "\n", encoding="utf-8")
        unfinished.replace(self.path / ORDER)
