"""Shrinking: the least fleet that still shows a finding."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from eal_actors.lab.proof.cases import KILLED, FaultCase
from eal_actors.lab.proof.findings import LEAST_FLEET, keep_finding
from eal_actors.lab.proof.fleet_files import KEYS_OF_ROBOTS, Content, with_faults
from eal_actors.lab.proof.invariants import Trials, Violation, judge
from eal_actors.lab.proof.trial import Trial, TrialTask, TrialWorker

MOST_TRIALS: Final = 60
"""A finding is shrunk with at most so many trials."""


@dataclass(frozen=True, slots=True)
class ShrinkTask:
    """A finding for a worker to shrink: `content` is the fleet without the faults, `within_s` as in `Trials`.

    The folder is for the least fleet file, and the record of its run.
    """

    content: Content
    case: FaultCase
    invariant: str
    within_s: float | None
    folder: Path


@dataclass(frozen=True, slots=True)
class LeastCase:
    """A finding, shrunk."""

    content: Content
    case: FaultCase
    violation: Violation
    trials: int

    @property
    def faulty_content(self) -> Content:
        """The least fleet, with the faults."""
        return with_faults(self.content, self.case)

    @property
    def size(self) -> tuple[int, int]:
        """The number of robots, and of faults."""
        return len(self.content["robots"]), len(self.case)

    def comments(self, scenario: Path) -> list[str]:
        """Return the head of the fleet file."""
        faults = [fault.label for fault in self.case]
        again = f"To repeat: eal run {scenario} --fleet {LEAST_FLEET}"
        return [f"{self.violation.invariant}: {self.violation.message}", *faults, again]


def task_of(content: Content, case: FaultCase) -> TrialTask:
    """Return the trial of a case."""
    kills = [fault.at_s for fault in case if fault.kind == KILLED]
    return TrialTask(with_faults(content, case), min(kills, default=None))


@dataclass
class ProofWorker:
    """Performs the tasks of a proof."""

    trials: TrialWorker

    def __call__(self, task: TrialTask | ShrinkTask) -> Trial | LeastCase | None:
        """Perform a trial, or shrink a finding and keep its record."""
        if isinstance(task, TrialTask):
            return self.trials(task)
        least = _Shrinker(task, self.trials).shrink()
        if least is not None:
            keep_finding(least.faulty_content, least.comments(self.trials.scenario), self.trials, task.folder)
        return least


@dataclass
class _Shrinker:
    _task: ShrinkTask
    _worker: TrialWorker
    _trials: int = 0

    def shrink(self) -> LeastCase | None:
        """Return the least fleet and faults that violate the invariant while the same fleet without faults holds all.

        Robots, faults and settings are left out one by one, as long as the finding stays. None if it does not repeat.
        """
        content, case = self._task.content, self._task.case
        violation = self._violation(content, case)
        if violation is None:
            return None
        is_smaller = True
        while is_smaller and self._trials < MOST_TRIALS:
            is_smaller = False
            for smaller in self._smaller(content, case):
                if self._trials >= MOST_TRIALS:
                    break
                found = self._violation(*smaller)
                if found is not None:
                    (content, case), violation, is_smaller = smaller, found, True
                    break
        return LeastCase(content, case, violation, self._trials)

    def _violation(self, content: Content, case: FaultCase) -> Violation | None:
        """Return the finding in a fleet, or None if it is not there, or also without the faults."""
        self._trials += 2
        healthy = self._worker(task_of(content, ()))
        if healthy.report is None or self._judge(healthy, healthy, ()):
            return None
        found = self._judge(healthy, self._worker(task_of(content, case)), case)
        return next((one for one in found if one.invariant == self._task.invariant), None)

    def _judge(self, healthy: Trial, trial: Trial, case: FaultCase) -> tuple[Violation, ...]:
        return judge(Trials(self._worker.loaded, case, healthy, trial, self._task.within_s))

    def _smaller(self, content: Content, case: FaultCase) -> Iterator[tuple[Content, FaultCase]]:
        """Yield the fleets and cases with one thing less, the largest things first."""
        if len(case) > 1:
            for fault in case:
                yield content, tuple(other for other in case if other is not fault)
        robots = content["robots"]
        needed = {fault.robot for fault in case}
        for name in robots:
            if name not in needed and len(robots) > 1:
                yield {**content, "robots": {other: robots[other] for other in robots if other != name}}, case
        yield from ((smaller, case) for smaller in _without_keys(content))


def _without_keys(content: Content) -> Iterator[Content]:
    """Yield the fleets with one key less."""
    for key in ("types", "python_steps", "map", "world", "plugin_dirs"):
        if key in content:
            changed: Content = _without(content, key)
            if key == "types":
                changed = _with_robots(changed, lambda robot: _without(robot, "type"))
            yield changed
    for key in KEYS_OF_ROBOTS:
        if any(key in robot for robot in content["robots"].values()):
            yield _with_robots(content, lambda robot, key=key: _without(robot, key))  # type: ignore[misc]
    if content["seed"]:
        yield {**content, "seed": 0}


def _without(mapping: Mapping[str, Any], key: str) -> dict[str, Any]:
    return {name: value for name, value in mapping.items() if name != key}


def _with_robots(content: Content, change: Callable[[Mapping[str, Any]], Mapping[str, Any]]) -> Content:
    return {**content, "robots": {name: change(robot) for name, robot in content["robots"].items()}}
