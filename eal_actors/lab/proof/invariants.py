"""The invariants of every run under faults. Pure: a trial is judged by the trial without faults."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from eal_actors.kernel.errors import DeadlineError
from eal_actors.lab.proof.cases import KILLED, FaultCase
from eal_actors.lab.proof.trial import Trial
from eal_actors.scenario import Report, Scenario, StepRecord
from eal_actors.scenario.language.scenario import Step
from eal_actors.scenario.language.values import RetryPolicy

INVARIANTS: Final = {
    "ends": "the run ends",
    "barriers": "no healthy robot fails because it waits for another",
    "halted": "every robot that can be reached stands still after the end",
    "minimum": "no run is done with fewer robots than the role's min",
    "contact": "no two robots touch that do not touch without faults",
    "finally": "every robot performs the steps of finally",
    "deadline": "every step, and the run, keeps its deadline",
    "outcome": "no run is done that was not",
}
"""The demand of each invariant, by its name."""

_STILL_M: Final = 0.002
_PLACE_M: Final = 0.3
_PLACE_RAD: Final = math.radians(45)
_SLACK_S: Final = 1.0
_MEETINGS: Final = ("barrier", "wait_for")
_STEPS_PER_DEADLINE: Final = 1.1


@dataclass(frozen=True, slots=True, order=True)
class Violation:
    """An invariant that a trial violated. Without a robot it is of the run, without a step of none in particular."""

    invariant: str
    robot: str
    step: str
    message: str


@dataclass(frozen=True, slots=True)
class Trials:
    """A trial, and all that it is judged by; `within_s` is by the fleet's clock, None for no limit."""

    scenario: Scenario
    case: FaultCase
    healthy: Trial
    trial: Trial
    within_s: float | None = None

    @property
    def faulty(self) -> set[str]:
        """The robots with faults."""
        return {fault.robot for fault in self.case if fault.kind != KILLED}

    @property
    def suspects(self) -> set[str]:
        """The robots that may have missed a part of their steps: with another controller, all of them."""
        is_killed = any(fault.kind == KILLED for fault in self.case)
        return set(_report(self).robots) if is_killed else self.faulty


def judge(trials: Trials) -> tuple[Violation, ...]:
    """Return the violated invariants of a trial; a run that was refused only has to leave the robots standing."""
    checks = [_check_world, *(_OF_REPORTS if trials.trial.report is not None else ())]
    return tuple(dict.fromkeys(violation for check in checks for violation in check(trials)))


def _check_world(trials: Trials) -> Iterator[Violation]:
    trial, usual = trials.trial, trials.healthy.touches or {}
    unreachable = {fault.robot for fault in trials.case if fault.is_unreachable and fault.until_s is None}
    if trial.is_late:
        yield Violation("ends", "", "", "the run did not end and was stopped")
    for name, moved_m in (trial.moved_m or {}).items():
        if moved_m > _STILL_M and name not in unreachable:
            yield Violation("halted", name, "", f"{name} moved {moved_m:.3f} m in the second after the end")
    for pair, time_s in (trial.touches or {}).items():
        if pair not in usual:
            yield Violation("contact", pair[0], "", f"{pair[0]} touched {pair[1]} at {time_s:.2f} s")


def _check_barriers(trials: Trials) -> Iterator[Violation]:
    for record in _report(trials).steps:
        is_late = record.error is not None and record.error.code == DeadlineError.code
        has_failed = record.outcome in ("failed", "dropped", "replaced")
        if record.kind in _MEETINGS and is_late and has_failed and record.robot not in trials.faulty:
            why = record.error.message if record.error is not None else ""
            yield Violation("barriers", record.robot or "", record.step, why)


def _check_minimum(trials: Trials) -> Iterator[Violation]:
    report = _report(trials)
    if report.outcome != "done":
        return
    for role, names in report.roles.items():
        least = trials.scenario.file.roles[role].min
        through = [name for name in names if report.robots[name].outcome in ("done", "replaced")]
        if len(through) < least:
            yield Violation("minimum", "", "", f"role '{role}' ended with {len(through)} of at least {least} robots")


def _check_finally(trials: Trials) -> Iterator[Violation]:
    healthy, report = trials.healthy.report, _report(trials)
    if healthy is None:
        return
    performed = {(record.robot, record.step) for record in report.steps if record.attempts > 0}
    for record in healthy.steps:
        is_final = record.step.startswith("finally") and record.robot in report.robots
        if is_final and (record.robot, record.step) not in performed:
            yield Violation("finally", record.robot or "", record.step, f"{record.robot} did not {record.label}")


def _check_deadlines(trials: Trials) -> Iterator[Violation]:
    report, limits_s = _report(trials), _deadlines_s(trials.scenario)
    for record in report.steps:
        if record.step not in limits_s:
            continue
        limit_s, took_s = limits_s[record.step](record.attempts), record.end_s - record.start_s
        if took_s > limit_s:
            message = f"{record.label} took {took_s:.1f} s, its deadlines allow {limit_s:.1f} s"
            yield Violation("deadline", record.robot or "", record.step, message)
    if trials.within_s is not None and report.duration_s > trials.within_s:
        message = f"the run took {report.duration_s:.1f} s, {trials.within_s:g} s are allowed"
        yield Violation("deadline", "", "", message)


def _deadlines_s(scenario: Scenario) -> Mapping[str, Callable[[int], float]]:
    """Return, by path, the longest time of the steps with a deadline in numbers, for a number of attempts."""
    found: dict[str, Callable[[int], float]] = {}
    for owner, _, name, step in scenario.walk():
        own_s = getattr(step, "timeout_s", None)
        limit_s = own_s if own_s is not None or step.children() else owner.file.timeout_s
        if isinstance(limit_s, int | float):
            found[name] = _longest(float(limit_s), step)
    return found


def _longest(limit_s: float, step: Step) -> Callable[[int], float]:
    policy = getattr(step, "on_failure", None)

    def longest_s(attempts: int) -> float:
        pauses_s = sum(map(policy.pause_s, range(1, attempts))) if isinstance(policy, RetryPolicy) else 0.0
        return (limit_s * max(1, attempts) + pauses_s) * _STEPS_PER_DEADLINE + _SLACK_S

    return longest_s


def _check_outcome(trials: Trials) -> Iterator[Violation]:
    """A scenario with an `expect` says itself what done means; without one, robots with faults are judged."""
    report, healthy = _report(trials), trials.healthy
    if report.outcome != "done" or trials.scenario.expectations():
        return
    for name in sorted(trials.suspects):
        if name not in report.robots or report.robots[name].outcome != "done":
            continue
        skipped = next((step for step in report.steps if step.robot == name and _was_skipped(step, healthy)), None)
        if skipped is not None:
            yield Violation("outcome", name, skipped.step, f"{name} is done, but {skipped.label} was skipped")
        if not report.dropped:  # a formation of fewer robots has other places
            yield from _check_place(trials, name)


def _check_place(trials: Trials, name: str) -> Iterator[Violation]:
    here, there = (trials.trial.poses or {}).get(name), (trials.healthy.poses or {}).get(name)
    if here is None or there is None:
        return
    apart_m, turn_rad = math.dist(here[:2], there[:2]), abs(math.remainder(here[2] - there[2], math.tau))
    if apart_m > _PLACE_M or turn_rad > _PLACE_RAD:
        apart = f"{apart_m:.2f} m and {math.degrees(turn_rad):.0f} degrees"
        yield Violation("outcome", name, "", f"{name} is done, but stands {apart} from where it ends without the fault")


def _was_skipped(step: StepRecord, healthy: Trial) -> bool:
    if step.outcome != "skipped" or healthy.report is None:
        return False
    return any(one.step == step.step and one.outcome == "done" for one in healthy.report.steps)


def _report(trials: Trials) -> Report:
    if trials.trial.report is None:
        raise AssertionError("the trial has no report")
    return trials.trial.report


_OF_REPORTS: Final = (_check_barriers, _check_minimum, _check_finally, _check_deadlines, _check_outcome)
