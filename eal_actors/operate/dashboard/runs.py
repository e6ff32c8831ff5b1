"""Runs: the scenarios that the page can start, and the one run that goes on."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

from eal_actors.actors.future import Future
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError, EALError, ScenarioError, WaitTimeoutError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.operate.dashboard.control import WHOLE, Control
from eal_actors.operate.dashboard.doings import Doings
from eal_actors.operate.dashboard.hub import Hub
from eal_actors.operate.dashboard.run_record import REPORT, RunRecord
from eal_actors.scenario import (
    Checkpoint,
    Event,
    LogLine,
    Plan,
    Report,
    RobotDropped,
    Run,
    RunEnded,
    RunPaused,
    RunResumed,
    RunStarted,
    StepEnded,
    StepStarted,
    load_scenario,
    make_plan,
)

_END_S: Final = 10.0
"""Real seconds in which a run that is aborted twice comes to its end."""
_RECORD_END_S: Final = 20.0
"""Real seconds in which the record of a run comes to its end, with its picture and its page."""
_MOST_FILES: Final = 200


class Runs:
    """Starts scenarios of one folder, one at a time, and tells the hub how they go.

    Args:
        fleet: a connected fleet.
        hub: what to tell.
        doings: what the robots do.
        control: who commands what.
        folder: where the scenario files are; only files right there can be started.
        runs_dir: where the folders of runs are made; None keeps no records.

    Thread: any. `listed` and `start` read files, and block as long.
    """

    def __init__(
        self,
        fleet: Fleet,
        hub: Hub,
        doings: Doings,
        control: Control,
        folder: Path | None,
        runs_dir: Path | None,
    ) -> None:
        self._fleet = fleet
        self._hub = hub
        self._doings = doings
        self._control = control
        self._folder = folder
        self._runs_dir = runs_dir
        self._lock = threading.Lock()
        self._run: Run | None = None
        self._future: Future[Report] | None = None
        self._records: list[RunRecord] = []
        self._reports: dict[str, Path] = {}
        self._number = 0
        self._showing = threading.Lock()
        self._shown: dict[str, Any] = {"phase": "none"}
        self._hub.put("run", {"": self._shown})

    def listed(self) -> list[dict[str, Any]]:
        """Return the scenarios of the folder: their files, parameters and roles, or what is wrong with them."""
        return [_described(file) for file in self._files().values()]

    def _files(self) -> Mapping[str, Path]:
        if self._folder is None or not self._folder.is_dir():
            return {}
        return {file.name: file for file in sorted(self._folder.glob("*.yaml"))[:_MOST_FILES]}

    def start(self, file: str, parameters: Mapping[str, object]) -> None:
        """Begin a run.

        Args:
            file: the scenario's file in the folder.
            parameters: values of its parameters.

        Raises:
            ScenarioError: no such file, a run goes on, or its folder cannot be made.
            ConfigError: what is wrong with the file, the parameters, or the fleet for it.
            RobotFailedError: a robot of the scenario did not start.
        """
        path = self._files().get(file)
        if path is None:
            raise ScenarioError(f"there is no scenario {file!r} here")
        with self._lock:
            if self._going() is not None:
                raise ScenarioError("a scenario is running already")
            scenario = load_scenario(path)
            plan = make_plan(scenario, self._fleet, parameters=parameters)
            self._begin(plan)
        get_logger().info("scenario started", scenario=scenario.name, file=file)

    def _begin(self, plan: Plan) -> None:
        """Begin a run, and its record. Thread: holds the lock."""
        record = RunRecord(self._fleet, plan, self._runs_dir) if self._runs_dir is not None else None
        self._number += 1
        with ExitStack() as undo:
            for robot in plan.robots:
                self._control.take(robot, WHOLE, f"scenario {plan.scenario.name}")
                undo.callback(self._control.done, robot, WHOLE)
            if record is not None:
                record.begin()
                undo.callback(record.drop)
            directory, listeners = (record.directory, [self._hear, record.hear]) if record else (None, [self._hear])
            self._run = run = Run(plan, self._fleet, directory, listeners)
            self._hub.clear("events")
            self._future = run.start()
            undo.pop_all()
        self._future.add_done_callback(lambda _: self._end_control(plan))
        if record is not None:
            number = self._number
            self._records = [*(other for other in self._records if other.is_open), record]
            record.finish_after(self._future, lambda report: self._show_report(number, report))

    def _end_control(self, plan: Plan) -> None:
        for robot in plan.robots:
            self._control.done(robot, WHOLE)

    def _show_report(self, number: int, report: Path) -> None:
        name = report.parent.name
        self._reports[name] = report
        with self._showing:
            if number == self._shown.get("run"):
                self._show({**self._shown, "report": f"/runs/{name}/{REPORT}"})

    def report(self, name: str) -> Path | None:
        """Return the report page of a run that was started here, by the name of its folder; None if there is none."""
        return self._reports.get(name)

    def control(self, what: str) -> None:
        """Pause, resume, step or abort the run.

        Raises:
            ScenarioError: no run goes on.
        """
        run = self._going()
        if run is None:
            raise ScenarioError("no scenario is running")
        match what:
            case "pause":
                run.pause()
            case "resume":
                run.resume()
            case "step":
                run.step()
            case "abort":
                run.abort("aborted from the dashboard")

    def abort(self, reason: str) -> None:
        """Abort the run, if one goes on."""
        run = self._going()
        if run is not None:
            run.abort(reason)

    def _going(self) -> Run | None:
        """Return the run that goes on, which it does not any more when the page is told of its end."""
        shown_ = self._shown
        is_over = shown_["phase"] == "ended" and shown_["run"] == self._number
        return None if self._future is None or self._future.done() or is_over else self._run

    def close(self) -> None:
        """Abort the run and wait for its end. Thread: blocks the caller, for a bounded time."""
        future = self._future
        if future is None:
            return
        self.abort("the dashboard was closed")
        self.abort("the dashboard was closed")  # which skips what is left of `finally`
        try:
            future.exception(timeout=self._fleet.clock.of_real(_END_S))
        except WaitTimeoutError:
            get_logger().error("the run does not end though it was aborted; it was left behind")
        for record in self._records:
            record.join(_RECORD_END_S)

    # What happens. Thread: the run's.

    def _hear(self, event: Event) -> None:
        if isinstance(event, Checkpoint):
            return
        with self._showing:
            self._note(event)
        fields = {"run": self._number, **event.to_dict()}
        if isinstance(event, RunStarted):
            fields["started_s"] = self._fleet.clock.now() - event.time_s
        self._hub.tell("events", fields)

    def _note(self, event: Event) -> None:
        """Keep what is shown of the run as a whole, and what each robot does."""
        shown_ = dict(self._shown)
        match event:
            case RunStarted():
                shown_ = {
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
            case StepStarted(robot=str(robot)):
                self._doings.begin(robot, event.step, event.label, self._fleet.clock.now())
            case StepEnded(record=record):
                if record.robot is not None:
                    self._doings.end(record.robot, record.step)
                    if record.error is not None and record.outcome != "aborted":
                        self._doings.fail(record.robot, f"{record.label}: {record.error.message}")
                if record.is_call and record.robot is not None:
                    done_by = shown_["done_by"]
                    shown_["done_by"] = {**done_by, record.robot: done_by.get(record.robot, 0) + 1}
                    shown_["done"] += 1
            case RunPaused():
                shown_["phase"] = "paused"
            case RunResumed():
                shown_["phase"] = "paused" if event.is_single_step else "running"
            case RobotDropped():
                get_logger(robot=event.robot).error("dropped from the scenario", reason=event.error.message)
            case LogLine():
                get_logger(**({"robot": event.robot} if event.robot else {})).info(
                    event.text, scenario=shown_["scenario"]
                )
            case RunEnded(report=report):
                self._doings.forget_run()
                error = report.error.message if report.error is not None else None
                shown_.update(phase="ended", outcome=report.outcome, error=error, duration_s=report.duration_s)
                get_logger().info("scenario ended", scenario=report.scenario, outcome=report.outcome)
        self._show(shown_)

    def _show(self, shown_: dict[str, Any]) -> None:
        self._shown = shown_
        self._hub.put("run", {"": shown_})


def _described(file: Path) -> dict[str, Any]:
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
        "roles": list(scenario.file.roles),
        "parameters": {name: section.model_dump() for name, section in scenario.file.parameters.items()},
        "problems": [],
    }
