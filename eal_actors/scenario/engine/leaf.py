"""Performs one step of one robot: its attempts, its record, and what follows from its failure."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from functools import partial
from typing import Any, Protocol, TypeAlias

from eal_actors.actors.future import Future
from eal_actors.kernel import spans
from eal_actors.kernel.errors import CallCancelledError, EALError
from eal_actors.scenario.engine.cast import Context, RobotRun
from eal_actors.scenario.engine.loop import Branch
from eal_actors.scenario.engine.stage import Stage
from eal_actors.scenario.events import StepEnded, StepRetried, StepStarted
from eal_actors.scenario.model import FallibleStep, OnFailure, RetryPolicy, final_action
from eal_actors.scenario.report import ErrorReport, StepOutcome, StepRecord


class Act(Protocol):
    """What a step does, for one robot or none.

    Attributes:
        label: what it does, for people.
        resource: the resource that it calls, or None.
        command: the text that the call is given, or None.
        is_begun: it has gone further than working out what to do.
        began_s: when it began, in seconds since the run's start, where it had to wait for others first.
        answer: what a call answered, or None.
        late: where no robot does it by itself, those who were at work in it when its time was up.
    """

    label: str
    resource: str | None
    command: str | None
    is_begun: bool
    began_s: float | None
    answer: object
    late: Sequence[RobotRun]

    def attempt(self) -> Branch:
        """Do it once.

        Raises:
            EALError: it failed.
        """
        ...


MakeAct: TypeAlias = Callable[[], Act]


def perform_leaf(
    stage: Stage, context: Context, step: FallibleStep, path: str, make: MakeAct, *, is_quiet: bool = False
) -> Branch:
    """Perform a step, with those who take the place of a robot that fails.

    Args:
        stage: the run.
        context: where the step stands.
        step: the step.
        path: its path.
        make: makes what it does, anew for each robot.
        is_quiet: only a failure is worth a record, for the step takes no time.
    """
    is_done = False
    while not is_done:
        yield from stage.admit(context)
        if not stage.goes_on(context):
            return
        is_done = yield from _Performance(stage, context, step, path, make(), is_quiet).perform()


class _Performance:
    """One step of one robot."""

    def __init__(self, stage: Stage, context: Context, step: FallibleStep, path: str, act: Act, is_quiet: bool) -> None:
        self._stage = stage
        self._context = context
        self._step = step
        self._path = path
        self._act = act
        self._is_quiet = is_quiet
        self._robot = context.robot
        self._policy: OnFailure = "drop" if context.is_finally else context.effective_policy(step.on_failure)
        self._retries = self._policy.retry if isinstance(self._policy, RetryPolicy) else 0

    def perform(self) -> Generator[Future[Any], None, bool]:
        """Perform it; return False if another robot has taken the place and is to do it again."""
        start_s = self._stage.tell(self._started) if not self._is_quiet else None
        span = self._new_span()
        attempts, error = yield from spans.during(span, self._attempts())
        if span is not None:
            span.end(error)
        if error is None:
            if start_s is not None:
                self._record(start_s, "done", attempts, None)
            return True
        outcome = self._outcome(attempts, error)
        if start_s is None:
            start_s = self._stage.tell(self._started)
        self._record(start_s, outcome, attempts if self._act.is_begun else 0, error)
        yield from self._follow(outcome, error)
        return outcome != "replaced"

    def _new_span(self) -> spans.Span | None:
        if spans.tracer is None or self._is_quiet:
            return None
        about = {"eal.step": self._path, "eal.label": self._act.label}
        if self._robot is not None:
            about["eal.robot"] = self._robot.name
        return spans.tracer.begin(f"step {self._step.kind}", about)

    def _started(self, time_s: float) -> StepStarted:
        context, act = self._context, self._act
        name = self._robot.name if self._robot is not None else None
        return StepStarted(
            time_s,
            name,
            self._path,
            act.label,
            context.role,
            context.branch,
            self._step.kind,
            act.resource,
            act.command,
        )

    def _attempts(self) -> Generator[Future[Any], None, tuple[int, EALError | None]]:
        attempts = 0
        while True:
            attempts += 1
            error: EALError | None = None
            try:
                yield from self._act.attempt()
            except EALError as caught:
                error = caught
            if error is None or self._is_over() or not self._act.is_begun or attempts > self._retries:
                return attempts, error
            name = self._robot.name if self._robot is not None else None
            self._stage.tell(partial(_retried, name, self._path, self._act.label, attempts, ErrorReport.of(error)))
            if isinstance(self._policy, RetryPolicy) and self._policy.back_off_s:
                try:
                    yield from self._stage.sleep(self._context, self._policy.pause_s(attempts))
                except CallCancelledError:
                    return attempts, error

    def _is_over(self) -> bool:
        """Return whether there is nothing to be tried again, for the run, the line or the robot is stopped."""
        return (
            self._stage.is_stopping
            or self._context.task.is_stopped
            or self._context.robot is not self._robot
            or (self._robot is not None and self._robot.outcome is not None and not self._context.is_finally)
        )

    def _outcome(self, attempts: int, error: EALError) -> StepOutcome:
        was_cut = isinstance(error, CallCancelledError) or attempts <= self._retries
        if self._context.robot is not self._robot and not self._stage.is_stopping:
            return "replaced"
        if self._stage.is_stopping and was_cut:
            return "aborted"
        if self._context.task.is_stopped and was_cut:
            return "stopped"
        if self._context.is_finally:
            return "failed"
        if self._robot is not None and self._robot.outcome is not None:
            return "dropped" if self._robot.outcome == "dropped" else "aborted"
        action = final_action(self._policy)
        if action == "skip":
            return "skipped"
        if action == "abort" or (self._robot is None and not self._act.late):
            return "failed"
        has_spare = action == "substitute" and self._spare() is not None
        return "replaced" if has_spare else "dropped"

    def _spare(self) -> RobotRun | None:
        seat = self._context.seat
        return self._stage.take_spare(seat.role) if seat is not None else None

    def _record(self, start_s: float, outcome: StepOutcome, attempts: int, error: EALError | None) -> None:
        context, act = self._context, self._act

        def ended(time_s: float) -> StepEnded:
            record = StepRecord(
                robot=self._robot.name if self._robot is not None else None,
                role=context.role,
                step=self._path,
                branch=context.branch,
                kind=self._step.kind,
                label=act.label,
                resource=act.resource,
                command=act.command,
                start_s=start_s if act.began_s is None else act.began_s,
                end_s=time_s,
                outcome=outcome,
                attempts=attempts,
                error=ErrorReport.of(error) if error is not None else None,
            )
            self._stage.records.append(record)
            return StepEnded(time_s, record, act.answer if error is None else None)

        self._stage.tell(ended)

    def _follow(self, outcome: StepOutcome, error: EALError) -> Branch:
        """Do what the policy says now that the last attempt has failed."""
        robot, stage = self._robot, self._stage
        if self._context.is_finally:
            if outcome == "failed" and robot is not None:
                robot.end("failed" if robot.outcome in (None, "done") else robot.outcome, error)
            elif outcome == "failed":
                stage.failures.append(error)
        elif outcome == "failed":
            if robot is not None:
                robot.end("failed", error)
            else:
                stage.failures.append(error)
            stage.stop()
        elif outcome == "dropped":
            leaving = [one for one in (self._act.late if robot is None else [robot]) if one.outcome is None]
            for one in leaving:
                stage.drop(one, error)
            yield from stage.halt(leaving)
        elif outcome == "replaced" and robot is not None and robot.outcome is None:
            seat, spare = self._context.seat, self._spare()
            if seat is not None and spare is not None:
                stage.replace(seat, spare, error)
                yield from stage.halt([robot])


def _retried(robot: str | None, step: str, label: str, attempt: int, error: ErrorReport, time_s: float) -> StepRetried:
    return StepRetried(time_s, robot, step, label, attempt, error)
