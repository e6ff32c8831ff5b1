"""The proof of a scenario: plans the cases, runs them in worker processes, judges them, and shrinks the findings."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import yaml

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ScenarioError
from eal_actors.lab.proof.cases import FaultCase, Injectable, Position, find_positions, plan_cases, single_faults
from eal_actors.lab.proof.findings import LEAST_FLEET, REPLAY
from eal_actors.lab.proof.fleet_files import (
    Content,
    fleet_content,
    injectable_faults,
    load_content,
    with_quick_settings,
)
from eal_actors.lab.proof.invariants import Trials, Violation, judge
from eal_actors.lab.proof.shrinking import LeastCase, ProofWorker, ShrinkTask, task_of
from eal_actors.lab.proof.trial import Trial, TrialTask, TrialWorker
from eal_actors.lab.worker_pool import run_all
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.twins import simulated
from eal_actors.recording.provenance import WORLD
from eal_actors.scenario import Report, Scenario, make_plan
from eal_actors.scenario.language.binding import Wishes, bound_robots

MOST_SHRUNK: Final = 20
"""So many findings are shrunk; others have the same cause, as a rule."""
_LIMIT_FACTOR: Final = 10.0
_LIMIT_S: Final = 3600.0
_LOG: Final = "workers.log"
_MARK: Final = "proof.json"

OnCase = Callable[["ProvenCase", int], None]
"""Receives each case as it ends, and the number of all cases."""


@dataclass(frozen=True, slots=True)
class ProofRequest:
    """A scenario to prove.

    Attributes:
        binding: robots by role, as the user bound them; None if the scenario binds them.
        keep: plugins that move nothing real, and are not replaced by simulated ones.
        runs: the largest number of cases.
        kinds: only these faults; empty for all.
        within_s: every run must end within this time of the fleet's clock; None for no such limit.
    """

    scenario: Scenario
    config: FleetConfig
    out: Path
    binding: Wishes | None = None
    keep: Sequence[str] = ()
    runs: int = 250
    jobs: int = 1
    kinds: Sequence[str] = ()
    within_s: float | None = None


@dataclass(frozen=True, slots=True)
class ProvenCase:
    """A case that was tried.

    Attributes:
        outcome: `done`, `failed` or `aborted`; `refused` if the run did not start or was not resumed, `crashed` if its
            process died.
        duration_s: by the fleet's clock.
        problem: the error of the run, or why it was refused.
    """

    case: FaultCase
    outcome: str
    duration_s: float
    problem: str
    violations: tuple[Violation, ...]

    @property
    def label(self) -> str:
        """Its faults for people."""
        return "; and ".join(fault.label for fault in self.case)


@dataclass(frozen=True, slots=True)
class Finding:
    """Violations that belong together: of one invariant, by the same faults, in the same steps.

    Attributes:
        cases: the cases, the one to shrink first.
        least: the least case; None if it was not shrunk.
        folder: of its fleet file and its record; None if it was not shrunk.
    """

    invariant: str
    cases: tuple[ProvenCase, ...]
    least: LeastCase | None = None
    folder: Path | None = None

    @property
    def violation(self) -> Violation:
        """The violation of the least case."""
        if self.least is not None:
            return self.least.violation
        return next(one for one in self.cases[0].violations if one.invariant == self.invariant)

    @property
    def fleet_file(self) -> Path | None:
        """The least fleet file."""
        return self.folder / LEAST_FLEET if self.folder is not None else None

    @property
    def replay(self) -> Path | None:
        """The page of its run."""
        page = self.folder / REPLAY if self.folder is not None else None
        return page if page is not None and page.is_file() else None


@dataclass(frozen=True, slots=True)
class Proof:
    """The result of a proof: its cases are in the order of the plan.

    Attributes:
        positions: the steps of the run without faults.
        unprovable: robots whose faults nobody can inject, and why.
        touching: robots that touch each other without faults, whose contacts are not judged.
        healthy: the report of the run without faults.
    """

    scenario: Scenario
    fleet: str
    positions: tuple[Position, ...]
    planned: int
    cases: tuple[ProvenCase, ...]
    findings: tuple[Finding, ...]
    unprovable: Mapping[str, str]
    touching: tuple[tuple[str, str], ...]
    healthy: Report
    out: Path
    kinds: tuple[str, ...] = field(default=())

    @property
    def is_proven(self) -> bool:
        """Whether all invariants held in all cases."""
        return not self.findings

    @property
    def singles(self) -> int:
        """The number of single faults that were tried."""
        return sum(len(case.case) == 1 for case in self.cases)


def prove(request: ProofRequest, on_case: OnCase = lambda _case, _count: None) -> Proof:
    """Run a scenario under faults, judge every run, and shrink the findings.

    Raises:
        PluginError: a robot has no place in the world.
        RobotFailedError: a robot did not start.
        ConfigError: the robots cannot perform the scenario, or cannot be simulated.
        ScenarioError: it is not done without faults, or does not repeat; or the folder is not a proof's.
        OSError: the folder cannot be written.

    Thread: blocks the caller.
    """
    scenario = request.scenario
    bound = bound_robots(scenario, request.config, request.binding)
    twins = simulated(request.config, bound, request.keep)
    prepare_folder(request.out)
    whole = fleet_content(twins.config, _write_world(twins.config, request.out))
    content = with_quick_settings(whole, twins.config.plugin_dirs)
    with Fleet(load_content(content, request.config.source)).connect() as fleet:  # nothing moves
        for problem in fleet.problems:
            raise problem
        make_plan(scenario, fleet, binding=request.binding)
    healthy = _healthy_trial(request, content)
    positions = find_positions(_require_done(healthy))
    injectable = injectable_faults(twins.config)
    singles = single_faults(positions, injectable, healthy.start_s, request.kinds)
    if not singles:
        raise ScenarioError("no fault can be tried: no robot whose plugin declares faults performs a step")
    runner = _CaseRunner(request, content, healthy)
    cases = runner.try_all(plan_cases(singles, request.runs, twins.config.seed), on_case)
    return Proof(
        scenario=scenario,
        fleet=request.config.name,
        positions=positions,
        planned=len(singles),
        cases=tuple(cases),
        findings=tuple(runner.shrink_all(group_findings(cases))),
        unprovable=_unprovable(bound, injectable, twins.left_out),
        touching=tuple(healthy.touches or ()),
        healthy=_require_done(healthy),
        out=request.out,
        kinds=tuple(dict.fromkeys(fault.kind for case in singles for fault in case)),
    )


def _worker(request: ProofRequest, limit_s: float) -> TrialWorker:
    scenario = request.scenario
    return TrialWorker(scenario.source, scenario.parameters, request.binding, request.config.source, limit_s)


def _healthy_trial(request: ProofRequest, content: Content) -> Trial:
    """Return the trial without faults, which must repeat to the bit."""
    worker = _worker(request, _LIMIT_S)
    one, other = worker(TrialTask(content)), worker(TrialTask(content))
    if _repeated(one) != _repeated(other):
        raise ScenarioError(
            f"scenario {request.scenario.name!r} does not repeat: two runs with the same seed differ, so that nothing "
            "can be proved; look for random numbers or the wall clock in its python steps"
        )
    return one


def _repeated(trial: Trial) -> tuple[Any, ...]:
    report = None if trial.report is None else trial.report.model_dump(exclude={"wall_started"})
    return report, trial.poses, trial.touches


def _require_done(trial: Trial) -> Report:
    if trial.report is None:
        raise ScenarioError(f"the run without faults did not start: {trial.problem}")
    if trial.report.outcome != "done":
        why = trial.report.error.message if trial.report.error is not None else ""
        raise ScenarioError(f"the run without faults is {trial.report.outcome}: {why}")
    return trial.report


class _CaseRunner:
    """The trials of one proof in worker processes."""

    def __init__(self, request: ProofRequest, content: Content, healthy: Trial) -> None:
        self._request = request
        self._content = content
        self._healthy = healthy
        limit_s = _LIMIT_S + _LIMIT_FACTOR * _require_done(healthy).duration_s
        self._perform = ProofWorker(_worker(request, limit_s))
        self._log = (request.out / _LOG).resolve()

    def try_all(self, cases: Sequence[FaultCase], on_case: OnCase) -> list[ProvenCase]:
        """Try cases in worker processes; return them in their order."""
        tasks = [task_of(self._content, case) for case in cases]
        numbers = {id(task): number for number, task in enumerate(tasks)}
        tried: dict[int, ProvenCase] = {}
        with closing(run_all(tasks, self._perform, self._log, self._request.jobs)) as ended:
            for one in ended:
                number = numbers[id(one.task)]
                trial = one.result if isinstance(one.result, Trial) else None
                tried[number] = self._judge(cases[number], trial, one.error or "")
                on_case(tried[number], len(cases))
        return [tried[number] for number in range(len(cases))]

    def _judge(self, case: FaultCase, trial: Trial | None, error: str) -> ProvenCase:
        if trial is None:
            return ProvenCase(case, "crashed", 0.0, error, (Violation("ends", "", "", f"the run crashed: {error}"),))
        request = self._request
        violations = judge(Trials(request.scenario, case, self._healthy, trial, request.within_s))
        if trial.report is None:
            return ProvenCase(case, "refused", 0.0, trial.problem, violations)
        problem = trial.report.error.message if trial.report.error is not None else ""
        return ProvenCase(case, trial.report.outcome, trial.report.duration_s, problem, violations)

    def shrink_all(self, findings: Sequence[Finding]) -> list[Finding]:
        """Shrink findings in worker processes; return all."""
        folder = self._request.out / "findings"
        tasks = [
            ShrinkTask(self._content, one.cases[0].case, one.invariant, self._request.within_s, folder / f"{number}")
            for number, one in enumerate(findings[:MOST_SHRUNK], 1)
            if one.cases[0].outcome != "crashed"
        ]
        least: dict[Path, LeastCase] = {}
        with closing(run_all(tasks, self._perform, self._log, self._request.jobs)) as ended:
            for one in ended:
                if isinstance(one.result, LeastCase):
                    least[one.task.folder] = one.result
        shrunk = {folder / f"{number}": one for number, one in enumerate(findings, 1)}
        return [
            Finding(one.invariant, one.cases, least[path], path) if path in least else one
            for path, one in shrunk.items()
        ]


def group_findings(cases: Iterable[ProvenCase]) -> list[Finding]:
    """Return the violations by invariant, kinds of faults and steps; a pair adds none that one of its faults has."""
    groups: dict[tuple[Any, ...], list[ProvenCase]] = {}
    for case in cases:
        for violation in dict.fromkeys(one.invariant for one in case.violations):
            parts = [(violation, ((fault.kind, fault.position.step),)) for fault in case.case]
            known = next((part for part in parts if part in groups), None)
            both = violation, tuple((fault.kind, fault.position.step) for fault in case.case)
            groups.setdefault(known or both, []).append(case)
    return [Finding(key[0], tuple(found)) for key, found in groups.items()]


def _unprovable(bound: Iterable[str], injectable: Injectable, left_out: Mapping[str, str]) -> dict[str, str]:
    without = "its plugin declares no faults in its manifest"
    found = {name: without for name in sorted(bound) if name not in injectable}
    return {**{name: f"left out: {why}" for name, why in left_out.items()}, **found}


def prepare_folder(out: Path) -> None:
    """Make the folder of a proof; remove an earlier proof from it.

    Raises:
        ScenarioError: the folder has other content.
        OSError: it cannot be written.
    """
    mark = out / _MARK
    if out.exists() and any(out.iterdir()) and not mark.is_file():
        raise ScenarioError(f"{out} is not the folder of a proof; choose another one with --out")
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    mark.write_text("{}\n", encoding="utf-8")


def _write_world(config: FleetConfig, out: Path) -> Path | None:
    if config.world is None:
        return None
    world = config.world.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    file = (out / WORLD).resolve()
    file.write_text(yaml.safe_dump({"version": 1, **world}, sort_keys=False), encoding="utf-8")
    return file
