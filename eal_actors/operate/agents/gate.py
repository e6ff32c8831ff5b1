"""PlanGate: the only way from an agent to a motion: examined, rehearsed, approved, and run once."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from eal_actors.actors.combine import gather
from eal_actors.actors.future import Future
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import (
    AccessDeniedError,
    ConfigError,
    EALError,
    Problem,
    ScenarioError,
    WaitTimeoutError,
    message_of,
)
from eal_actors.kernel.log import get_logger
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.operate.agents.examination import RehearsalResult, Rehearser, dry_run, read_plan
from eal_actors.operate.agents.plans import PlanStore, StoredPlan, plan_hash
from eal_actors.operate.agents.policy import Policy, PolicyRule
from eal_actors.operate.run_record import RunRecord
from eal_actors.recording.provenance import resolved_fleet
from eal_actors.scenario import Plan, Report, Run

_END_S: Final = 10.0  # real seconds for the end of a run that was aborted twice
_RECORD_END_S: Final = 20.0
_STOP_S: Final = 5.0  # real seconds for the robots to confirm a stop
_WAITS_UNTIL_DONE: Final = 60.0


class PlanGate:
    """Examines, keeps and runs the plans of agents on a connected fleet, one run at a time.

    The rehearsals of a plan may take `rehearsal_limit_s` real seconds. Thread: any. `examine`, `submit` and `start`
    block on files and a rehearsal.
    """

    def __init__(
        self, fleet: Fleet, runs_dir: Path, policy: Policy | None = None, rehearsal_limit_s: float = 120.0
    ) -> None:
        self.fleet: Final = fleet
        self.store: Final = PlanStore(runs_dir)
        self._runs_dir = runs_dir
        self._policy = policy if policy is not None else Policy()
        self._rehearser = Rehearser(fleet.config.source, rehearsal_limit_s)
        self._lock = threading.Lock()
        self._run: Run | None = None
        self._future: Future[Report] | None = None
        self._record: RunRecord | None = None
        self._hash = ""
        self._aborts = 0
        self._watcher: threading.Thread | None = None
        self._is_closed = False

    def examine(self, text: str, parameters: Mapping[str, object]) -> tuple[Plan, tuple[str, ...]]:
        """Check a plan and make its dry run; nothing moves.

        Raises:
            ConfigError: with every problem, each with its position.
            EALError: a robot did not start.
        """
        return dry_run(read_plan(text, parameters), self.fleet)

    def rehearse(self, text: str, parameters: Mapping[str, object]) -> RehearsalResult:
        """Check a plan, and rehearse it in simulation.

        Raises EALError as for `examine`, or if the plan cannot be rehearsed.
        """
        self.examine(text, parameters)
        return self._rehearser.rehearse(text, parameters)

    def submit(self, text: str, parameters: Mapping[str, object], agent: str) -> tuple[StoredPlan, list[Problem]]:
        """Examine, rehearse and keep a plan, which a policy may approve at once; return it, and why no rule allows it.

        Raises EALError as for `rehearse`, or if the plan did not end well there, or too many plans wait.
        """
        plan, lines = self.examine(text, parameters)
        rehearsal = self._rehearser.rehearse(text, parameters)
        if rehearsal.problem is not None:
            raise ScenarioError(rehearsal.problem)
        summary = {**rehearsal.summary, "duration_s": rehearsal.duration_s}
        stored = self.describe(plan, lines, text, parameters, agent, summary)
        rule, reasons = self._policy.judge(plan, self.fleet, rehearsal.duration_s)
        with self._lock:
            if self._is_active() and self._hash == stored.hash:
                raise ScenarioError("this plan is running; submit it again after its end")
            self.store.keep(stored)
        if rule is not None:
            self.store.decide(stored, _policy_name(rule), is_approved=True)
        return stored, reasons

    def describe(
        self,
        plan: Plan,
        lines: tuple[str, ...],
        text: str,
        parameters: Mapping[str, object],
        agent: str,
        rehearsal: Mapping[str, Any],
    ) -> StoredPlan:
        """Return a stored plan."""
        return StoredPlan(
            hash=plan_hash(text, parameters, _content_of(self.fleet.config)),
            name=plan.scenario.name,
            fleet=self.fleet.name,
            text=text,
            parameters=dict(parameters),
            agent=agent,
            submitted=wall_time(),
            robots=plan.robots,
            steps=lines,
            rehearsal=dict(rehearsal),
        )

    @property
    def aborts(self) -> int:
        """The number of aborts so far, with or without a run."""
        return self._aborts

    def start(self, text: str, aborts: int | None = None) -> StoredPlan:
        """Start the run of an approved plan, by its hash or the beginning of it.

        Args:
            text: the hash.
            aborts: the number of aborts when this was asked for, for an abort that comes while the plan is examined;
                now if None.

        Raises:
            AccessDeniedError: it is not approved, was used, or is for another fleet or other robots.
            ScenarioError: a run is active, this start was aborted, or the gate is closed.
            EALError: the robots cannot run it now.
        """
        aborts = self._aborts if aborts is None else aborts
        stored = self.store.find(text)
        if plan_hash(stored.text, stored.parameters, _content_of(self.fleet.config)) != stored.hash:
            raise AccessDeniedError(f"plan {stored.hash[:12]} is for another fleet, or was changed: submit it again")
        with self._lock:
            if self._is_closed:
                raise ScenarioError("the door for agents is closed")
            if self._is_active():
                raise ScenarioError("a plan is already running")
            plan, lines = self.examine(stored.text, stored.parameters)
            if (plan.robots, lines) != (stored.robots, stored.steps):
                now = ", ".join(plan.robots)
                raise AccessDeniedError(f"plan {stored.hash[:12]} has other robots now: {now}; submit it again")
            rule = self._rule_of(stored, plan)
            if self._aborts != aborts:
                raise ScenarioError("aborted before it began")
            self.store.use(stored)
            self._begin(stored, plan, None if rule is None else rule.max_duration_s)
            if self._aborts != aborts and self._run is not None:  # the abort may not have seen the run
                self._run.abort("aborted while it began")
        get_logger().info("plan started", plan=stored.hash[:12], scenario=stored.name)
        return stored

    def _rule_of(self, stored: StoredPlan, plan: Plan) -> PolicyRule | None:
        """Return the rule that approved a plan, which must still allow it; None if a person approved it."""
        decision = self.store.decision(stored)
        if decision is None or not decision.who.startswith(_policy_name(None)):
            return None
        rule, _ = self._policy.judge(plan, self.fleet, float(stored.rehearsal["duration_s"]))
        if rule is None or _policy_name(rule) != decision.who:
            raise AccessDeniedError(f"the policy no longer allows plan {stored.hash[:12]}: submit it again")
        return rule

    def _begin(self, stored: StoredPlan, plan: Plan, limit_s: float | None) -> None:
        record = RunRecord(self.fleet, plan, self._runs_dir)
        record.start()
        try:
            self._run = run = Run(plan, self.fleet, record.directory, [record.hear])
            self._future = run.start()
        except BaseException:
            record.cancel()
            raise
        self._record, self._hash = record, stored.hash
        record.finish_after(self._future, lambda _: None)
        if limit_s is not None:
            self._watcher = threading.Thread(target=_end_after, args=(run, self._future, limit_s), daemon=True)
            self._watcher.start()

    def status(self, wait_s: float = 0.0) -> dict[str, Any]:
        """Return the state of the last run, after waiting at most so many real seconds for its end."""
        future, record = self._future, self._record
        if future is None or record is None:
            return {"state": "none"}
        try:
            report = future.get(timeout=self.fleet.clock.of_real(min(max(wait_s, 0.0), _WAITS_UNTIL_DONE)))
        except WaitTimeoutError:
            return {"state": "running", "hash": self._hash, "folder": record.directory.name}
        error = report.error.message if report.error is not None else None
        ended = {"state": "ended", "outcome": report.outcome, "error": error, "duration_s": report.duration_s}
        return {**ended, "hash": self._hash, "folder": record.directory.name}

    def abort(self, reason: str) -> bool:
        """Abort the run; return whether there is one. Thread: any; does not block."""
        self._aborts += 1
        run, is_active = self._run, self._is_active()
        if run is not None and is_active:
            run.abort(reason)
        return is_active

    def stop(self, reason: str) -> dict[str, str | None]:
        """Abort the run and stop every robot; return for each the reason why it did not confirm, or None."""
        self.abort(reason)
        answers = {name: robot.stop(reason) for name, robot in self.fleet.items()}
        done = gather(answers.values(), return_exceptions=True)
        try:
            done.get(timeout=self.fleet.clock.of_real(_STOP_S))
        except WaitTimeoutError:
            get_logger().error("not all robots have confirmed the stop", waited_s=_STOP_S)
        return {name: _unconfirmed(answer) for name, answer in answers.items()}

    def close(self) -> None:
        """Abort the run and wait for its end; no other begins. Thread: blocks the caller, for a bounded time."""
        with self._lock:
            self._is_closed = True
        self._rehearser.close()
        if (future := self._future) is None:
            return
        for _ in range(2):  # the second time also skips the rest of `finally`
            self.abort("the agent's door was closed")
        try:
            future.exception(timeout=self.fleet.clock.of_real(_END_S))
        except WaitTimeoutError:
            get_logger().error("the aborted run has not ended; it is abandoned", waited_s=_END_S)
        if self._record is not None:
            self._record.join(_RECORD_END_S)

    def _is_active(self) -> bool:
        return self._future is not None and not self._future.done()


def _content_of(config: FleetConfig) -> dict[str, Any]:
    """Return the fleet's part of a plan's hash: its file with includes, and its world."""
    world = config.world.model_dump(mode="json") if config.world is not None else None
    return {**resolved_fleet(config), "world": world}


def _policy_name(rule: PolicyRule | None) -> str:
    return f"policy rule '{rule.name}'" if rule is not None else "policy rule '"


def _unconfirmed(answer: Future[None]) -> str | None:
    if not answer.done():
        return f"no answer within {_STOP_S:g} s"
    error = answer.exception()
    return None if error is None else message_of(error)


def _end_after(run: Run, future: Future[Report], limit_s: float) -> None:
    """Abort a run that takes longer than its policy allows, and its `finally` steps if they take as long again."""
    for _ in range(2):
        try:
            future.exception(timeout=limit_s)
        except WaitTimeoutError:
            run.abort(f"it took longer than the {limit_s:g} s that the policy allows")


def describe_problems(error: EALError) -> list[str]:
    """Return the lines of an error: each problem of a file with its position, or the message."""
    return [str(problem) for problem in error.problems] if isinstance(error, ConfigError) else [error.message]
