"""RunRecord: the record of a run that the dashboard or an agent started, the same as that of `eal run`."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Final

from eal_actors.actors.future import Future
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import EALError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.recording import (
    RunFolder,
    RunRecorder,
    draw_run,
    folder_errors,
    keep_provenance,
    new_run_folder,
    repair_interrupted,
)
from eal_actors.recording.report_page import render_report
from eal_actors.scenario import Plan, Report

REPORT: Final = "report.html"


class RunRecord:
    """The record of one run, in a new folder `directory` below `runs_dir`; `hear` is the listener for its events.

    Raises:
        ConfigError: the folder cannot be made.
        ScenarioError: it cannot be written.
    """

    def __init__(self, fleet: Fleet, plan: Plan, runs_dir: Path) -> None:
        self._world = fleet.config.world
        repair_interrupted(runs_dir)
        self.directory: Final = new_run_folder(runs_dir, plan.scenario.name)
        with folder_errors(self.directory):
            keep_provenance(self.directory, fleet.config, plan.scenario)
            robots = [name for name in plan.robots if name not in plan.lost]
            self._recorder = RunRecorder(fleet, robots, self.directory)
        self.hear: Final = self._recorder.hear
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start to record, before the run starts. Thread: blocks the caller for a moment."""
        self._recorder.__enter__()

    def finish_after(self, run: Future[Report], on_report: Callable[[Path], None]) -> None:
        """Finish the record at the end of the run, in its own thread, and call back with the report page."""
        self._thread = threading.Thread(target=self._finish, args=(run, on_report), name="run record", daemon=True)
        self._thread.start()

    def cancel(self) -> None:
        """End the record of a run that did not start."""
        self._recorder.__exit__(None, None, None)

    @property
    def is_open(self) -> bool:
        """Whether the record is still being written."""
        return self._thread is not None and self._thread.is_alive()

    def join(self, timeout_s: float) -> None:
        """Wait until the record is complete. Thread: blocks the caller, at most for the time-out."""
        if self._thread is not None:
            self._thread.join(timeout_s)
            if self._thread.is_alive():
                get_logger().error("the record of the run is incomplete", directory=str(self.directory))

    def _finish(self, run: Future[Report], on_report: Callable[[Path], None]) -> None:
        has_failed = run.exception() is not None  # logged by the run
        self._recorder.__exit__(None, None, None)
        if has_failed:
            return
        try:
            folder = RunFolder.open(self.directory)
            draw_run(folder, run.get(), self._world)
            page = render_report(folder, self._world)
            with folder_errors(self.directory):
                (self.directory / REPORT).write_text(page, encoding="utf-8")
        except EALError as error:
            reason = error_text(error)
            get_logger().error("the report of the run was not made", directory=str(self.directory), reason=reason)
            return
        on_report(self.directory / REPORT)
