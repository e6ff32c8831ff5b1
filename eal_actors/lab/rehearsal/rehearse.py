"""Run of a scenario in an observed simulation, with its proximity events related to the scenario's steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from eal_actors.facade.fleet import Fleet
from eal_actors.lab.rehearsal.proximity import ClosestApproach, ProximityEvent, ProximityRecorder
from eal_actors.managers.twins import SimulatedFleet
from eal_actors.scenario import Report, RunEvent, RunStarted, Scenario, StepRecord, run_scenario
from eal_actors.scenario.language.binding import Wishes

_ROUNDING_S: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Incident:
    """A proximity event, and the steps of the two robots at their closest approach.

    Its times are seconds since the run's start; earlier ones are 0.
    """

    approach: ProximityEvent
    steps: tuple[StepRecord, ...]


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """The result of one rehearsed run.

    Attributes:
        starts: first position of each robot, x and y in metres, by name.
        nearest: closest approach by robot; a robot with nothing within 1 m has no entry.
        incidents: the proximity events under the margin, ordered by start.
    """

    seed: int
    report: Report
    starts: Mapping[str, tuple[float, float]]
    nearest: Mapping[str, ClosestApproach]
    incidents: tuple[Incident, ...]

    @property
    def is_clear(self) -> bool:
        """Whether the run finished without incidents."""
        return self.report.outcome == "done" and not self.incidents


def rehearse(
    scenario: Scenario,
    fleet: SimulatedFleet,
    margin_m: float,
    seed: int,
    directory: Path | None = None,
    binding: Wishes | None = None,
) -> Rehearsal:
    """Run a scenario once with every robot of the fleet in the world, including those that take no part.

    A gap between outlines smaller than `margin_m` is an incident. Without a directory no files are kept.

    Raises:
        ConfigError: the robots cannot perform the scenario.
        PluginError: a robot has no place in the world.
        RobotFailedError: a robot did not start.
        ScenarioError: the scenario saves files, and there is no directory.

    Thread: blocks the caller.
    """
    recorder = ProximityRecorder(margin_m)
    opened = Fleet(replace(fleet.config, seed=seed))
    opened.services.proximity_observer = recorder
    start_s = 0.0

    def note_start(event: RunEvent) -> None:
        nonlocal start_s
        if isinstance(event, RunStarted):
            start_s = opened.clock.now() - event.time_s

    with opened:
        for problem in opened.problems:
            raise problem
        report = run_scenario(scenario, opened, directory=directory, listeners=[note_start], binding=binding)
    names = {body: robot for robot, body in fleet.bodies.items() if robot != body}
    return Rehearsal(
        seed=seed,
        report=report,
        starts={names.get(body, body): place for body, place in recorder.robots.items()},
        nearest={names.get(body, body): _since(near, start_s, names) for body, near in recorder.nearest.items()},
        incidents=tuple(_incident(event, start_s, names, report.steps) for event in recorder.events),
    )


def _incident(event: ProximityEvent, start_s: float, names: Mapping[str, str], steps: Sequence[StepRecord]) -> Incident:
    robot, nearest = names.get(event.robot, event.robot), _since(event.nearest, start_s, names)
    since_start = ProximityEvent(robot, nearest, max(0.0, event.start_s - start_s), max(0.0, event.end_s - start_s))
    causes = [step for step in steps if _is_cause(step, nearest.time_s)]
    own = [step for name in (robot, nearest.other) for step in causes if step.robot == name]
    of_a_role = [step for step in causes if step.robot is None and step.role is not None]  # a formation
    return Incident(since_start, tuple(own or of_a_role))


def _is_cause(step: StepRecord, time_s: float) -> bool:
    """Return whether a step may have caused the state at a time; a step that starts just then has not."""
    has_begun = step.start_s < time_s - _ROUNDING_S or time_s <= _ROUNDING_S
    return has_begun and time_s <= step.end_s + _ROUNDING_S and step.start_s <= time_s + _ROUNDING_S


def _since(nearest: ClosestApproach, start_s: float, names: Mapping[str, str]) -> ClosestApproach:
    """Return a closest approach with its time since the run's start, and bodies replaced by their robots' names."""
    other = names.get(nearest.other, nearest.other)
    return replace(nearest, other=other, time_s=max(0.0, nearest.time_s - start_s))
