"""One run of a scenario under faults, and what the world shows of it: contacts, true poses, motion after the end.

Time is in lock step, so a trial repeats to the bit. A killed controller is simulated so: all robots halt, as they do
without a controller; the record is cut there; and the same robots perform what `eal run --resume` makes of it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from eal_actors.actors.future import Future
from eal_actors.device.localization.pose_estimate import Pose
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import Clock, new_waiter
from eal_actors.kernel.errors import EALError, ScenarioError
from eal_actors.lab.proof.fleet_files import Content, load_content
from eal_actors.lab.rehearsal.proximity import TOUCH_M, ProximityRecorder
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.scenario import Plan, Report, Run, Scenario, load_scenario, make_plan, read_run
from eal_actors.scenario.language.binding import Wishes
from eal_actors.scenario.language.parameters import with_parameters
from eal_actors.scenario.report.journal import EVENTS, SUMMARY

_TRUE_POSE: Final = "TruePose"
_AFTER_S: Final = 1.0
_RUN_OF: Final = "the proof"


@dataclass(frozen=True, slots=True)
class TrialTask:
    """A trial for a worker; its controller is killed at `kill_at_s`, in seconds of the fleet's clock, or never."""

    content: Content
    kill_at_s: float | None = None


@dataclass(frozen=True, slots=True)
class Trial:
    """The observations of a trial.

    Attributes:
        report: None if the scenario did not start, or was not resumed.
        problem: why it did not start, or was not resumed; empty if it was.
        start_s: the run's start by the fleet's clock.
        is_late: it was stopped at the time limit.
        touches: the time of the first contact of two robots, since the run's start, by their names.
        moved_m: the way of each robot in the second after the end.
        poses: the true pose of each robot at the end.
    """

    report: Report | None
    problem: str = ""
    start_s: float = 0.0
    is_late: bool = False
    touches: Mapping[tuple[str, str], float] | None = None
    moved_m: Mapping[str, float] | None = None
    poses: Mapping[str, Pose] | None = None


@dataclass
class TrialWorker:
    """Performs trials; loads the scenario at the first one. A run is stopped after `limit_s` of the fleet's clock."""

    scenario: Path
    parameters: Mapping[str, object]
    binding: Wishes | None
    source: Path
    limit_s: float

    def __call__(self, task: TrialTask) -> Trial:
        """Perform a trial."""
        config = load_content(task.content, self.source)
        return perform_trial(self.loaded, config, self.binding, self.limit_s, task.kill_at_s)

    @cached_property
    def loaded(self) -> Scenario:
        """The scenario."""
        return with_parameters(load_scenario(self.scenario), self.parameters)


def perform_trial(
    scenario: Scenario, config: FleetConfig, binding: Wishes | None, limit_s: float, kill_at_s: float | None = None
) -> Trial:
    """Run a scenario once, with every robot of the fleet in the world.

    The run is stopped at `limit_s`, and its controller killed at `kill_at_s`, both by the fleet's clock.

    Thread: blocks the caller.
    """
    contacts = ProximityRecorder(TOUCH_M)
    fleet = Fleet(config)
    fleet.services.proximity_observer = contacts
    with fleet, TemporaryDirectory(prefix="eal-proof-") as folder:
        try:
            fleet.connect()
            for problem in fleet.problems:
                raise problem
            plan = make_plan(scenario, fleet, binding=binding)
        except EALError as error:
            return Trial(None, str(error))
        trial = _perform(plan, fleet, Path(folder) / "run", limit_s, kill_at_s)
        before = _true_poses(fleet)
        fleet.clock.sleep(_AFTER_S)
        after = _true_poses(fleet)
        return replace(
            trial,
            touches=_touches(contacts, fleet, trial.start_s),
            moved_m={name: math.dist(before[name][:2], after[name][:2]) for name in before},
            poses=before,
        )


def _perform(plan: Plan, fleet: Fleet, directory: Path, limit_s: float, kill_at_s: float | None) -> Trial:
    """Perform the scenario; in two halves if its controller, the process that performs it, is killed."""
    clock = fleet.clock
    run = Run(plan, fleet, directory, keeps_files=False)
    future = run.start()
    start_s = run.start_s
    if kill_at_s is not None and not ends_before(future, clock, kill_at_s - clock.now()):
        stop_run(run, future, clock)
        cut_record(directory, kill_at_s - start_s)
        try:
            past = read_run(directory)
            run = Run(plan, fleet, directory, resumption=past, keeps_files=False)
        except ScenarioError as error:
            return Trial(None, str(error).replace(f" in {directory}", ""), start_s)
        future = run.start()
    is_late = not ends_before(future, clock, limit_s)
    if is_late:
        stop_run(run, future, clock)
    return Trial(future.get(), "", start_s, is_late)


def stop_run(run: Run, future: Future[Report], clock: Clock) -> None:
    """Stop a run at once, without its `finally`, and halt its robots."""
    run.abort(f"stopped by {_RUN_OF}")
    run.abort(f"stopped by {_RUN_OF}")
    ends_before(future, clock, None)


def ends_before(future: Future[Report], clock: Clock, timeout_s: float | None) -> bool:
    """Wait for the end of a run; return whether it came in time."""
    over = new_waiter()
    future.add_done_callback(lambda _: clock.wake(over))
    if not future.done():
        clock.wait(over, timeout_s if timeout_s is None else max(0.0, timeout_s))
    return future.done()


def cut_record(directory: Path, time_s: float) -> None:
    """Reduce the record of a run to its events before a time since its start, as if its process had died there."""
    (directory / SUMMARY).unlink(missing_ok=True)
    lines = (directory / EVENTS).read_text(encoding="utf-8").splitlines(keepends=True)
    kept = [line for line in lines if json.loads(line)["time_s"] < time_s]
    (directory / EVENTS).write_text("".join(kept or lines[:1]), encoding="utf-8")


def _touches(contacts: ProximityRecorder, fleet: Fleet, start_s: float) -> dict[tuple[str, str], float]:
    """Return the first contact of each two robots; walls and obstacles do not count."""
    found: dict[tuple[str, str], float] = {}
    for event in contacts.events:
        if event.is_hit and event.nearest.other in fleet:
            one, other = sorted((event.robot, event.nearest.other))
            found.setdefault((one, other), event.nearest.time_s - start_s)
    return found


def _true_poses(fleet: Fleet) -> dict[str, Pose]:
    found: dict[str, Pose] = {}
    for name, robot in fleet.items():
        if _TRUE_POSE in robot:
            x_m, y_m, yaw_rad = map(float, robot[_TRUE_POSE].get_value().get().value)
            found[name] = (x_m, y_m, yaw_rad)
    return found
