"""Runs a scenario in a simulated world that is watched, and tells who came too near to what, and while doing what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from eal_actors.device.proximity import ProximityObserver
from eal_actors.facade.fleet import Fleet
from eal_actors.lab.rehearsal.approaches import Approach, Approaches, Nearest
from eal_actors.managers.twins import SimulatedFleet
from eal_actors.scenario import Report, RunEvent, RunStarted, Scenario, StepRecord, run_scenario
from eal_actors.scenario.language.binding import Wishes

_ROUNDING_S: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Incident:
    """An approach, in the words of the scenario.

    Attributes:
        approach: who came how near to what, with times in seconds since the run's start; before it they are 0.
        steps: what was under way when they were nearest: the steps of the robots that were near, if they had any.
    """

    approach: Approach
    steps: tuple[StepRecord, ...]


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """One run of a rehearsal.

    Attributes:
        seed: where all its randomness started from.
        report: what came of the run.
        starts: where each robot stood at first, x and y in metres, by name.
        nearest: by robot, the nearest that anything came to it; nobody within 1 m has no entry.
        incidents: the approaches nearer than the margin, in the order in which they began.
    """

    seed: int
    report: Report
    starts: Mapping[str, tuple[float, float]]
    nearest: Mapping[str, Nearest]
    incidents: tuple[Incident, ...]

    @property
    def is_clear(self) -> bool:
        """Whether the run was done, and nobody came too near to anything."""
        return self.report.outcome == "done" and not self.incidents


def rehearse(
    scenario: Scenario,
    fleet: SimulatedFleet,
    margin_m: float,
    seed: int,
    directory: Path | None = None,
    binding: Wishes | None = None,
) -> Rehearsal:
    """Run a scenario once, with every robot of the fleet in the world, those too that take no part.

    Args:
        scenario: the scenario, with the values of its parameters.
        fleet: the simulated fleet.
        margin_m: what comes nearer than this, from outline to outline, is an incident.
        seed: where all randomness starts from.
        directory: the run's folder for what it leaves behind; None keeps nothing.
        binding: robots by role, in place of what the role asks for.

    Raises:
        ConfigError: what the robots cannot do.
        PluginError: a robot has no place in the world.
        RobotFailedError: a robot did not start.
        ScenarioError: the scenario saves files, and there is no directory.

    Thread: blocks the caller.
    """
    approaches = Approaches(margin_m)
    opened = Fleet(replace(fleet.config, seed=seed))
    opened.services.proximity_observer = ProximityObserver(approaches.reach_m, approaches.observe)
    begin = _Begin(opened)
    with opened:
        for problem in opened.problems:
            raise problem
        report = run_scenario(scenario, opened, directory=directory, listeners=[begin.hear], binding=binding)
    names = {body: robot for robot, body in fleet.bodies.items() if robot != body}
    return _told(seed, report, approaches, begin.start_s, names)


def _told(seed: int, report: Report, approaches: Approaches, start_s: float, names: Mapping[str, str]) -> Rehearsal:
    """Return what was seen of a run that began at a time of the fleet's clock, bodies by the names of their robots."""
    return Rehearsal(
        seed=seed,
        report=report,
        starts={names.get(body, body): place for body, place in approaches.robots.items()},
        nearest={names.get(body, body): _since(near, start_s, names) for body, near in approaches.nearest.items()},
        incidents=tuple(_incident(approach, start_s, names, report.steps) for approach in approaches.found),
    )


class _Begin:
    """Notes when a run begins, in seconds of the fleet's clock."""

    def __init__(self, fleet: Fleet) -> None:
        self.start_s = 0.0
        self._clock = fleet.clock

    def hear(self, event: RunEvent) -> None:
        if isinstance(event, RunStarted):
            self.start_s = self._clock.now() - event.time_s


def _incident(approach: Approach, start_s: float, names: Mapping[str, str], steps: Sequence[StepRecord]) -> Incident:
    robot, nearest = names.get(approach.robot, approach.robot), _since(approach.nearest, start_s, names)
    since_start = Approach(robot, nearest, max(0.0, approach.start_s - start_s), max(0.0, approach.end_s - start_s))
    under_way = [
        step
        for who in (robot, nearest.other)
        for step in steps
        if step.robot == who and _is_under_way(step, nearest.time_s)
    ]
    return Incident(since_start, tuple(under_way))


def _is_under_way(step: StepRecord, time_s: float) -> bool:
    """Return whether how things stand at a time came of a step; what has just begun has changed nothing yet."""
    has_begun = step.start_s < time_s - _ROUNDING_S or time_s <= _ROUNDING_S
    return has_begun and time_s <= step.end_s + _ROUNDING_S and step.start_s <= time_s + _ROUNDING_S


def _since(nearest: Nearest, start_s: float, names: Mapping[str, str]) -> Nearest:
    """Return the same with times that count from the run's start, and bodies by the names of their robots."""
    other = names.get(nearest.other, nearest.other)
    return replace(nearest, other=other, time_s=max(0.0, nearest.time_s - start_s))
