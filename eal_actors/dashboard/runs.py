"""Runs: the scenarios that the page can start, and the one run that goes on."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from eal_actors.actors.future import Future
from eal_actors.clock import wall_time
from eal_actors.dashboard.doings import Doings
from eal_actors.dashboard.hub import Hub
from eal_actors.errors import ConfigError, EALError, ScenarioError, WaitTimeoutError, shown
from eal_actors.facade.fleet import Fleet
from eal_actors.log import get_logger
from eal_actors.scenario import (
    Checkpoint,
    Event,
    LogLine,
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
_MOST_FILES: Final = 200


class Runs:
    """Starts scenarios of one folder, one at a time, and tells the hub how they go.

    Args:
        fleet: a connected fleet.
        hub: what to tell.
        doings: what the robots do.
        folder: where the scenario files are; only files right there can be started.
        runs_dir: where the folders of runs are made; None keeps no records.

    Thread: any. `listed` and `start` read files, and block as long.
    """

    def __init__(self, fleet: Fleet, hub: Hub, doings: Doings, folder: Path | None, runs_dir: Path | None) -> None:
        self._fleet = fleet
        self._hub = hub
        self._doings = doings
        self._folder = folder
        self._runs_dir = runs_dir
        self._lock = threading.Lock()
        self._run: Run | None = None
        self._future: Future[Report] | None = None
        self._number = 0
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
            if self._future is not None and not self._future.done():
                raise ScenarioError("a scenario is running already")
            scenario = load_scenario(path)
            plan = make_plan(scenario, self._fleet, parameters=parameters)
            directory = self._new_directory(scenario.name)
            self._number += 1
            self._run = run = Run(plan, self._fleet, directory, [self._hear])
            self._hub.clear("events")
            self._future = run.start()
        get_logger().info("scenario started", scenario=scenario.name, file=file)

    def _new_directory(self, scenario: str) -> Path | None:
        if self._runs_dir is None:
            return None
        name = f"{scenario}-{wall_time():%Y%m%dT%H%M%SZ}"
        directory, number = self._runs_dir / name, 1
        while directory.exists():
            number += 1
            directory = self._runs_dir / f"{name}-{number}"
        return directory

    def control(self, what: str) -> None:
        """Pause, resume, step or abort the run.

        Raises:
            ScenarioError: no run goes on.
        """
        run, future = self._run, self._future
        if run is None or future is None or future.done():
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
        run, future = self._run, self._future
        if run is not None and future is not None and not future.done():
            run.abort(reason)

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

    # What happens. Thread: the run's.

    def _hear(self, event: Event) -> None:
        if isinstance(event, Checkpoint):
            return
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
                self._doings.begin(robot, event.label, self._fleet.clock.now(), key=event.step)
            case StepEnded(record=record):
                if record.robot is not None:
                    failure = record.error.message if record.error is not None and record.outcome != "aborted" else None
                    self._doings.end(record.robot, record.step, f"{record.label}: {failure}" if failure else None)
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
        self._shown = shown_
        self._hub.put("run", {"": shown_})


def _described(file: Path) -> dict[str, Any]:
    try:
        scenario = load_scenario(file)
    except ConfigError as error:
        return {"file": file.name, "name": file.stem, "problems": [str(problem) for problem in error.problems]}
    except EALError as error:
        return {"file": file.name, "name": file.stem, "problems": [shown(error)]}
    return {
        "file": file.name,
        "name": scenario.name,
        "description": scenario.file.description,
        "roles": list(scenario.file.roles),
        "parameters": {name: section.model_dump() for name, section in scenario.file.parameters.items()},
        "problems": [],
    }
