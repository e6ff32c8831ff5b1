"""The script of a robot: its steps and its path in a rehearsal, which the look-ahead continues from its live pose.

A rehearsal resolves loops, conditions and Python steps, and its twins drive as the robots do. The engine cannot begin
a scenario in the middle of its steps. So the twins drive the whole plan once, before the run, and the look-ahead moves
the rest of their paths to the estimated poses. The twins pass through each other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Timer
from typing import Final

import numpy as np
import numpy.typing as npt

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.log import get_logger
from eal_actors.managers.twins import SimulatedFleet
from eal_actors.recording.poses import PoseRecorder
from eal_actors.scenario import Run, RunEvent, Scenario, StepEnded, StepStarted, make_plan
from eal_actors.scenario.language.binding import Wishes

Floats = npt.NDArray[np.float64]

_LIMIT_S: Final = 3600.0
"""A rehearsal is stopped after this time of its clock; the rest of the plan has no forecast."""
_PATIENCE_S: Final = 60.0
"""A rehearsal is stopped after this real time too."""
_WAITS: Final = frozenset({"barrier", "wait_for", "wait_until"})
_MAP_MOTIONS: Final = frozenset({"go_to", "follow", "formation", "visit"})
_TOO_LONG: Final = "the rehearsal of the look-ahead takes too long: the rest of the plan has no forecast"
_GOALS: Final = frozenset({"goto", "follow"})


@dataclass(frozen=True, slots=True)
class ScriptStep:
    """A step of a robot in a rehearsal; times are seconds since the rehearsal's start.

    It begins when it has waited for other robots. With a goal it drives to a place in the map frame, which corrects
    deviations; other motions keep them.
    """

    path: str
    start_s: float
    begin_s: float
    end_s: float
    has_goal: bool = False


class Script:
    """The steps of a robot in a rehearsal, in the order of their starts, and its path.

    `times_s` are seconds since the rehearsal's start, increasing, at least one; `poses` are x in m, y in m and yaw in
    rad in the map frame at these times, (n, 3). `touches_s` are the times at which it touched a wall or
    another thing that is no robot.
    """

    def __init__(
        self, steps: Sequence[ScriptStep], times_s: Floats, poses: Floats, touches_s: Sequence[float] = ()
    ) -> None:
        self.steps = tuple(steps)
        self.touches_s = tuple(touches_s)
        self._times_s = times_s
        self._poses = np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])

    def poses_at(self, times_s: Floats) -> Floats:
        """Return the poses at some times, shape (n, 3); the yaw is unwrapped."""
        return np.column_stack([np.interp(times_s, self._times_s, self._poses[:, axis]) for axis in range(3)])


def rehearse_scripts(scenario: Scenario, fleet: SimulatedFleet, binding: Wishes | None = None) -> dict[str, Script]:
    """Run a scenario with simulated robots, and return the script of each robot that took part.

    Raises:
        ConfigError: the robots cannot perform the scenario.
        RobotFailedError: a robot did not start.

    Thread: blocks the caller. No real robot moves.
    """
    started: dict[tuple[str, str], float] = {}
    steps: dict[str, list[ScriptStep]] = {}

    stopped: list[str] = []

    def stop() -> None:
        if not stopped:
            stopped.append(_TOO_LONG)
            get_logger().warning(_TOO_LONG)
            run.abort(_TOO_LONG)

    def hear(event: RunEvent) -> None:
        if event.time_s > _LIMIT_S:
            stop()
        if isinstance(event, StepStarted) and event.robot is not None:
            started[event.robot, event.step] = event.time_s
        elif isinstance(event, StepEnded) and (robot := event.record.robot) is not None:
            record = event.record
            is_wait = record.kind in _WAITS
            goal = record.kind in _MAP_MOTIONS or (record.command or "") in _GOALS
            start_s = started.pop((robot, record.step), record.start_s)
            begin_s = record.end_s if is_wait else record.start_s
            steps.setdefault(robot, []).append(ScriptStep(record.step, start_s, begin_s, record.end_s, goal))

    other_seed = replace(fleet.config, seed=fleet.config.seed + 1)  # the errors of the robots are not known in advance
    opened = Fleet(other_seed)
    opened.services.solid_robots = False  # a contact would end motions that the real robots may complete
    with TemporaryDirectory(prefix="eal-lookahead-") as folder, opened:
        plan = make_plan(scenario, opened, binding=binding)
        run = Run(plan, opened, Path(folder) / "run", [hear], keeps_files=False)
        with PoseRecorder(opened, plan.robots) as recorder:
            timer = Timer(_PATIENCE_S, stop)
            timer.start()
            try:
                run.start().get()
            finally:
                timer.cancel()
        paths = recorder.paths_since(run.start_s)
        touches: dict[str, list[float]] = {}  # of walls and things: robots pass through each other
        for contact in opened.services.contacts.copy():
            touches.setdefault(contact.robot, []).append(contact.time_s - run.start_s)
    scripts = {}
    for robot, path in paths.items():
        if path and all(math.isfinite(sample.x_m) for sample in path):
            table = np.array(path, dtype=np.float64)
            in_order = sorted(steps.get(robot, ()), key=lambda step: step.start_s)
            scripts[robot] = Script(in_order, table[:, 0], table[:, 1:], touches.get(robot, ()))
    return scripts
