"""LiveRecord: the record of a fleet that others command. It is the folder of a run that has one step: to wait."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, Final, Self

from eal_actors.actors.robot_view import RobotState
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import UnavailableError
from eal_actors.recording.provenance import SCENARIO, keep_provenance
from eal_actors.recording.run_folder import folder_errors
from eal_actors.recording.run_recorder import Extent, RunRecorder
from eal_actors.scenario import (
    ErrorReport,
    Listener,
    LossReport,
    Report,
    RobotLost,
    RobotReport,
    RobotReturned,
    RunEnded,
    RunEvent,
    RunStarted,
    Scenario,
    parse_scenario,
)
from eal_actors.scenario.language.scenario import scenario_hash
from eal_actors.scenario.report.journal import Journal

NAME: Final = "record"
_ROLE: Final = "robots"
_SCENARIO: Final = """\
# Written by `eal record`, which commands nothing.
version: 1
name: {name}
description: Wait for as long as the fleet was recorded.
roles: {{{role}: {{}}}}
steps: [{{on: {role}, do: [{{wait_s: {duration_s:.3f}}}]}}]
"""


class LiveRecord:
    """Records an open fleet inside its `with` block; it commands nothing and halts nothing.

    Args:
        fleet: the connected fleet, on a clock in real time.
        directory: the folder, which must exist.
        listeners: called with each event, in the thread of a robot; they must not block.

    Raises:
        ScenarioError: the folder cannot be written, or has a record already.
    """

    def __init__(
        self, fleet: Fleet, directory: Path, extent: Extent = "sensors", listeners: Sequence[Listener] = ()
    ) -> None:
        self._fleet = fleet
        self._directory = directory
        self._wall_started = wall_time().isoformat()
        self._lock = threading.Lock()
        self._has_ended = False
        self._losses: dict[str, list[LossReport]] = {name: [] for name in fleet}
        self._observers = ExitStack()
        self._scenario_hash = scenario_hash(scenario := _scenario(1.0))
        with folder_errors(directory), ExitStack() as on_error:
            # First, since it refuses a folder with another record, which must stay as it is.
            self._journal = Journal(directory, [lambda event: self._recorder.hear(event), *listeners])
            on_error.callback(self._journal.close)
            keep_provenance(directory, fleet.config, scenario)
            self._recorder = RunRecorder(fleet, fleet, directory, extent)
            on_error.pop_all()
        self._zero_s = fleet.clock.now()

    def __enter__(self) -> Self:
        self._recorder.__enter__()
        self._zero_s = self._fleet.clock.now()
        self._write(
            lambda time_s: RunStarted(
                time_s,
                scenario_hash=self._scenario_hash,
                roles={_ROLE: tuple(self._fleet)},
                spares={},
                robots=tuple(self._fleet),
                calls=0,
                **self._about(),
            )
        )
        for robot in self._fleet.values():
            self._observers.callback(robot.on_state(partial(self._note, robot.name)))
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._observers.close()
        try:
            with folder_errors(self._directory):
                with self._lock:  # a robot's thread may still be in _note
                    self._has_ended = True
                    report = self._report(self._fleet.clock.now() - self._zero_s)
                    self._write(lambda time_s: RunEnded(time_s, report))
                (self._directory / SCENARIO).write_text("\n".join(_scenario(report.duration_s).lines), encoding="utf-8")
                self._journal.write_summary(report)
        finally:
            self._journal.close()
            self._recorder.__exit__(*exc_info)

    def _note(self, name: str, state: RobotState) -> None:
        """Record the loss and the return of a robot. Thread: the robot's."""
        with self._lock:
            losses = self._losses[name]
            is_lost = bool(losses) and losses[-1].back_s is None
            if self._has_ended:
                return
            if state is RobotState.LOST and not is_lost:
                problems = self._fleet[name].problems
                error = ErrorReport.of(problems[-1] if problems else UnavailableError("is out of reach", robot=name))
                losses.append(LossReport(lost_s=self._write(lambda time_s: RobotLost(time_s, name, error))))
            elif state is RobotState.READY and is_lost:
                back_s = self._write(lambda time_s: RobotReturned(time_s, name))
                losses[-1] = losses[-1].model_copy(update={"back_s": back_s})

    def _write(self, make_event: Callable[[float], RunEvent]) -> float:
        """Record an event; return the seconds since the start."""
        time_s = self._fleet.clock.now() - self._zero_s
        self._journal.write(make_event(time_s))
        return time_s

    def _about(self) -> dict[str, Any]:
        """Return the fields that the first event and the report share."""
        config = self._fleet.config
        return {
            "scenario": NAME,
            "scenario_file": SCENARIO,
            "fleet": config.name,
            "fleet_file": str(config.source),
            "seed": config.seed,
            "rate": config.rate,
            "parameters": {},
        }

    def _report(self, duration_s: float) -> Report:
        return Report(
            roles={_ROLE: list(self._fleet)},
            wall_started=self._wall_started,
            duration_s=duration_s,
            paused_s=0.0,
            outcome="done",
            error=None,
            robots={name: RobotReport(outcome="done", losses=tuple(losses)) for name, losses in self._losses.items()},
            steps=(),
            **self._about(),
        )


def _scenario(duration_s: float) -> Scenario:
    return parse_scenario(_SCENARIO.format(name=NAME, role=_ROLE, duration_s=duration_s), SCENARIO)
