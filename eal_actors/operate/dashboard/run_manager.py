"""RunManager: the scenarios that the page can start, and the current run."""

from __future__ import annotations

import secrets
import threading
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

from eal_actors.actors.future import Future
from eal_actors.kernel.errors import (
    ConfigError,
    EALError,
    PreemptedError,
    ScenarioError,
    StoppedError,
    WaitTimeoutError,
    error_text,
)
from eal_actors.kernel.log import get_logger
from eal_actors.operate.agents.plans import PlanStore, StoredPlan
from eal_actors.operate.dashboard.control import WHOLE, DashboardContext
from eal_actors.operate.run_record import REPORT, RunRecord
from eal_actors.scenario import (
    Checkpoint,
    LogLine,
    Plan,
    Report,
    RobotDropped,
    Run,
    RunEnded,
    RunEvent,
    RunPaused,
    RunResumed,
    RunStarted,
    StepEnded,
    StepStarted,
    load_scenario,
    make_plan,
)
from eal_actors.scenario.report.summary import StepRecord

_END_S: Final = 10.0  # real seconds for the end of a run that was aborted twice
_RECORD_END_S: Final = 20.0  # real seconds for the end of a run's record, with its picture and its report
_MOST_FILES: Final = 200
_CLOSED: Final = "the dashboard was closed"
_STOP_CODES: Final = (PreemptedError.code, StoppedError.code)
"""Of errors that a stop causes. They are over with the resume, and no errors of a robot."""


class RunManager:
    """Runs the scenarios of one folder, one at a time, and reports them to the store.

    Scenarios are files right in `folder`. With `runs_dir` None, runs leave no records. Thread: any. `list_scenarios`
    and `start` block on files.
    """

    def __init__(self, context: DashboardContext, folder: Path | None, runs_dir: Path | None) -> None:
        self._fleet, self._store, self._steps, self._control = context
        self._folder = folder
        self._runs_dir = runs_dir
        self._plans = PlanStore(runs_dir) if runs_dir is not None else None
        self._lock = threading.Lock()
        self._run: Run | None = None
        self._future: Future[Report] | None = None
        self._records: list[RunRecord] = []
        self._reports: dict[str, Path] = {}
        self._number = 0
        self._status_lock = threading.Lock()
        self._status: dict[str, Any] = {}
        self._set_status({"phase": "none"})

    def list_scenarios(self) -> list[dict[str, Any]]:
        """Return the files, parameters and roles of the folder's scenarios, or their problems."""
        return [_describe_scenario(file) for file in self._files().values()]

    def list_plans(self) -> list[dict[str, Any]]:
        """Return the plans of agents that wait for a decision. Thread: blocks on files."""
        return [] if self._plans is None else [_describe_plan(plan) for plan in self._plans.waiting()]

    def decide(self, plan: str, who: str, *, is_approved: bool) -> None:
        """Approve or refuse the plan of an agent. Thread: blocks on files.

        Raises:
            ScenarioError: the dashboard keeps no runs, or the plan does not wait for a decision.
            ArgumentError: there is no such plan.
        """
        if self._plans is None:
            raise ScenarioError("the dashboard has no folder of runs, where plans are")
        self._plans.decide(self._plans.find(plan), who, is_approved=is_approved)

    def _files(self) -> Mapping[str, Path]:
        if self._folder is None or not self._folder.is_dir():
            return {}
        return {file.name: file for file in sorted(self._folder.glob("*.yaml"))[:_MOST_FILES]}

    def start(self, file: str, parameters: Mapping[str, object]) -> None:
        """Start a run of a file in the folder.

        Raises:
            ScenarioError: no such file, another run is active, or the run's folder cannot be made.
            ConfigError: the file or the parameters are wrong, or the fleet does not fit.
            RobotFailedError: a robot of the scenario did not start.
            ResourceBusyError: a robot of the scenario is driven by hand.
        """
        if (path := self._files().get(file)) is None:
            raise ScenarioError(f"there is no scenario {file!r} in the dashboard's folder of scenarios")
        with self._lock:
            if self._active_run() is not None:
                raise ScenarioError("a scenario is already running")
            scenario = load_scenario(path)
            self._start(make_plan(scenario, self._fleet, parameters=parameters))
        get_logger().info("scenario started", scenario=scenario.name, file=file)

    def _start(self, plan: Plan) -> None:
        """Start a run and its record. Thread: holds the lock."""
        with ExitStack() as undo:
            for robot in plan.robots:
                self._control.acquire(robot, WHOLE, f"scenario {plan.scenario.name}")
                undo.callback(self._control.done, robot, WHOLE)
            record = RunRecord(self._fleet, plan, self._runs_dir) if self._runs_dir is not None else None
            self._number += 1
            if record is not None:
                record.start()
                undo.callback(record.cancel)
            directory, listeners = (record.directory, [self._hear, record.hear]) if record else (None, [self._hear])
            self._run = run = Run(plan, self._fleet, directory, listeners)
            self._store.clear("events")
            self._future = run.start()
            undo.pop_all()
        self._future.add_done_callback(lambda _: self._end_control(plan))
        if record is not None:
            number = self._number
            self._records = [*(other for other in self._records if other.is_open), record]
            record.finish_after(self._future, lambda report: self._add_report(number, report))

    def _end_control(self, plan: Plan) -> None:
        for robot in plan.robots:
            self._control.done(robot, WHOLE)

    def _add_report(self, number: int, report: Path) -> None:
        name = secrets.token_urlsafe(16)  # only pages of users receive the path, which works like a key
        self._reports[name] = report
        with self._status_lock:
            if number == self._status.get("run"):
                self._update(report=f"/runs/{name}/{REPORT}")

    def report(self, name: str) -> Path | None:
        """Return the report page of a run that was started here, by the secret in its path; None if there is none."""
        return self._reports.get(name)

    def control(self, what: str) -> None:
        """Pause, resume, step or abort the run. Raises ScenarioError if no run is active."""
        if (run := self._active_run()) is None:
            raise ScenarioError("no scenario is running")
        if what == "abort":
            run.abort("aborted from the dashboard")
        else:
            {"pause": run.pause, "resume": run.resume, "step": run.step}[what]()

    def abort(self, reason: str) -> None:
        """Abort the run, if there is one."""
        if (run := self._active_run()) is not None:
            run.abort(reason)

    def _active_run(self) -> Run | None:
        """Return the run until the page shows its end, which is before the future resolves."""
        is_over = self._status["phase"] == "ended" and self._status["run"] == self._number
        return None if self._future is None or self._future.done() or is_over else self._run

    def close(self) -> None:
        """Abort the run and wait for its end. Thread: blocks the caller, for a bounded time."""
        if (future := self._future) is None:
            return
        self.abort(_CLOSED)
        self.abort(_CLOSED)  # the second time also skips the rest of `finally`
        try:
            future.exception(timeout=self._fleet.clock.of_real(_END_S))
        except WaitTimeoutError:
            get_logger().error("the aborted run has not ended; it is abandoned", waited_s=_END_S)
        for record in self._records:
            record.join(_RECORD_END_S)

    # Events. Thread: the run's.

    def _hear(self, event: RunEvent) -> None:
        if isinstance(event, Checkpoint):
            return
        with self._status_lock:
            self._record(event)
        fields = {"run": self._number, **event.to_dict()}
        if isinstance(event, RunStarted):
            fields["started_s"] = self._fleet.clock.now() - event.time_s
        self._store.append("events", fields)

    def _record(self, event: RunEvent) -> None:
        """Update the status of the run and the current steps. Thread: holds the status lock."""
        match event:
            case RunStarted():
                self._record_start(event)
            case StepStarted(robot=str(robot)):
                self._steps.start(robot, event.step, event.label, self._fleet.clock.now())
            case StepEnded(record=record):
                if record.robot is not None:
                    self._record_end(record, record.robot)
            case RunPaused():
                self._update(phase="paused")
            case RunResumed():
                self._update(phase="paused" if event.is_single_step else "running")
            case RobotDropped():
                logger = get_logger(robot=event.robot)
                log = logger.warning if event.error.code in _STOP_CODES else logger.error
                log("dropped from the scenario", reason=event.error.message)
            case LogLine():
                logger = get_logger(robot=event.robot) if event.robot else get_logger()
                logger.info(event.text, scenario=self._status["scenario"])
            case RunEnded(report=report):
                self._record_report(report)

    def _record_start(self, event: RunStarted) -> None:
        self._set_status(
            {
                "phase": "running",
                "run": self._number,
                "scenario": event.scenario,
                "robots": list(event.robots),
                "calls": event.calls,
                "done": 0,
                "done_by": dict.fromkeys(event.robots, 0),
                "started_s": self._fleet.clock.now() - event.time_s,
                "outcome": None,
                "error": None,
            }
        )

    def _record_end(self, record: StepRecord, robot: str) -> None:
        self._steps.end(robot, record.step)
        is_of_stop = record.error is not None and record.error.code in _STOP_CODES
        if record.error is not None and record.outcome != "aborted" and not is_of_stop:
            self._steps.record_error(robot, f"{record.label}: {record.error.message}")
        if record.is_call:
            done_by = self._status["done_by"]
            self._update(done_by={**done_by, robot: done_by.get(robot, 0) + 1}, done=self._status["done"] + 1)

    def _record_report(self, report: Report) -> None:
        self._steps.clear()
        error = report.error.message if report.error is not None else None
        self._update(phase="ended", outcome=report.outcome, error=error, duration_s=report.duration_s)
        if report.outcome == "done":
            self._update(calls=self._status["done"])  # those that it needed; the plan only estimated them
        get_logger().info("scenario ended", scenario=report.scenario, outcome=report.outcome)

    def _update(self, **fields: Any) -> None:
        self._set_status({**self._status, **fields})

    def _set_status(self, status: dict[str, Any]) -> None:
        self._status = status
        self._store.put("run", {"": status})


def _describe_plan(plan: StoredPlan) -> dict[str, Any]:
    kept = plan.model_dump(mode="json", include={"hash", "name", "agent", "text", "parameters", "robots"})
    return {**kept, "duration_s": plan.rehearsal["duration_s"]}


def _describe_scenario(file: Path) -> dict[str, Any]:
    try:
        scenario = load_scenario(file)
    except ConfigError as error:
        return {"file": file.name, "name": file.stem, "problems": [str(problem) for problem in error.problems]}
    except EALError as error:
        return {"file": file.name, "name": file.stem, "problems": [error_text(error)]}
    return {
        "file": file.name,
        "name": scenario.name,
        "description": scenario.file.description,
        "parameters": {name: section.model_dump() for name, section in scenario.file.parameters.items()},
        "problems": [],
    }
