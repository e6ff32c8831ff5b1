"""RunRecord: what a run that the page started leaves behind, which is what `eal run` leaves."""

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
    render_report,
)
from eal_actors.scenario import Plan, Report

REPORT: Final = "report.html"


class RunRecord:
    """The record of one run.

    Args:
        fleet: the connected fleet.
        plan: what is to be run.
        runs_dir: where the run's folder is made.

    Attributes:
        directory: the run's folder.
        hear: hears each event of the run.

    Raises:
        ConfigError: the folder cannot be made.
        ScenarioError: it cannot be written.
    """

    def __init__(self, fleet: Fleet, plan: Plan, runs_dir: Path) -> None:
        self._world = fleet.config.world
        self.directory: Final = new_run_folder(runs_dir, plan.scenario.name)
        with folder_errors(self.directory):
            keep_provenance(self.directory, fleet.config, plan.scenario)
            robots = [name for name in plan.robots if name not in plan.lost]
            self._recorder = RunRecorder(fleet, robots, self.directory)
        self.hear: Final = self._recorder.hear
        self._thread: threading.Thread | None = None

    def begin(self) -> None:
        """Begin to record, before the run begins. Thread: blocks the caller for a moment."""
        self._recorder.__enter__()

    def finish_after(self, run: Future[Report], tell: Callable[[Path], None]) -> None:
        """Finish the record in a thread of its own when the run is over, and tell where the report page is."""
        self._thread = threading.Thread(target=self._finish, args=(run, tell), name="dashboard record", daemon=True)
        self._thread.start()

    def drop(self) -> None:
        """End it: the run has not begun."""
        self._recorder.__exit__(None, None, None)

    @property
    def is_open(self) -> bool:
        """Whether there is still something to be written."""
        return self._thread is not None and self._thread.is_alive()

    def join(self, timeout_s: float) -> None:
        """Wait for the end of a run's record, at most so long. Thread: blocks the caller."""
        if self._thread is not None:
            self._thread.join(timeout_s)
            if self._thread.is_alive():
                get_logger().error("the record of the run was left behind unfinished", directory=str(self.directory))

    def _finish(self, run: Future[Report], tell: Callable[[Path], None]) -> None:
        has_failed = run.exception() is not None  # which the run itself has logged
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
            get_logger().error("there is no report of the run", directory=str(self.directory), reason=error_text(error))
            return
        tell(self.directory / REPORT)
