"""The execution of steps: attempts, records, failure policies, and time limits."""

from __future__ import annotations

from collections.abc import Callable, Generator, Hashable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

from eal_actors.actors.future import Future
from eal_actors.kernel import spans
from eal_actors.kernel.errors import (
    CallCancelledError,
    CallError,
    DeadlineError,
    EALError,
    StoppedError,
)
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.frames import ExecutionContext, Participant, StepTask
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.engine.synchronization import StepGroup
from eal_actors.scenario.language.expressions import Expression, Namespace, WorkLimitError, expressions_in, render
from eal_actors.scenario.language.values import (
    OnFailure,
    RetryPolicy,
    Wanted,
    checked_number,
    final_action,
)
from eal_actors.scenario.report.events import StepEnded, StepRetried, StepStarted
from eal_actors.scenario.report.summary import ErrorReport, StepOutcome, StepRecord

if TYPE_CHECKING:  # steps import this module
    from eal_actors.scenario.engine.past_steps import PastStep
    from eal_actors.scenario.steps.base import BlockStep, FallibleStep, Step


class StepAction:
    """A step as one robot performs it, or no robot.

    Args:
        run: the run.
        context: the context of the step.
        label: the step in records, for people.
        work: performs the step once.

    Attributes:
        resource: the resource that it calls, or None.
        command: the text argument of the call, or None.
        is_begun: it has gone further than evaluating its expressions.
        began_s: when it began, in seconds since the run's start, if it had to wait for others first.
        answer: the answer of a call, or None.
        late: outside of `on`, the robots that were at work when its time was up.
        path: where the record keeps its readings; None if the step itself is in the record.
    """

    def __init__(
        self,
        run: RunContext,
        context: ExecutionContext,
        label: str,
        work: Callable[[StepAction], Coroutine],
    ) -> None:
        self.run = run
        self.context = context
        self.label = label
        self.resource: str | None = None
        self.command: str | None = None
        self.is_begun = True
        self.began_s: float | None = None
        self.answer: object = None
        self.late: Sequence[Participant] = ()
        self.path: str | None = None
        self._work = work

    def attempt(self) -> Coroutine:
        """Perform the step once.

        Raises:
            EALError: the attempt failed.
        """
        return self._work(self)

    def read(self, value: object) -> Generator[Future[Any], None, Namespace]:
        """Return the namespace for the `${...}` in a value.

        Raises:
            EALError: a reading failed.
        """
        return self.evaluate(expressions_in(value))

    def evaluate(self, expressions: Iterable[Expression]) -> Generator[Future[Any], None, Namespace]:
        """Return the namespace for expressions.

        Raises:
            EALError: a reading failed.
        """
        return self.run.read(self.context, expressions, path=self.path)

    def number(self, value: object, wanted: Wanted, what: str) -> Generator[Future[Any], None, float]:
        """Return a number that may be an expression.

        Raises:
            EALError: a reading failed, or the number is out of its range.
        """
        names = yield from self.read(value)
        return checked_number(render(value, names), wanted, what)


MakeAction: TypeAlias = Callable[[], StepAction]


def perform_steps(run: RunContext, steps: Sequence[Step], path: str, context: ExecutionContext) -> Coroutine:
    """Perform steps one after the other."""
    for index, step in enumerate(steps):
        if not run.may_begin(context):
            return
        if run.losses is not None and run.losses.skips(context, step):
            run.losses.record_skip(context, step, f"{path}[{index}]")
        else:
            yield from step.perform(run, context.of(step), f"{path}[{index}]")


def perform_step(
    run: RunContext,
    context: ExecutionContext,
    step: FallibleStep,
    path: str,
    make: MakeAction,
    *,
    is_quiet: bool = False,
) -> Generator[Future[Any], None, bool]:
    """Perform a step; if a spare replaces its robot, perform it again with the spare.

    Before all that, leave it out if an interrupted run has performed it.

    Args:
        run: the run.
        context: the context of the step.
        step: the step.
        path: its path.
        make: makes the action, anew for each robot.
        is_quiet: record only a failure.

    Returns:
        Whether it has succeeded.
    """
    if run.past is not None and not is_quiet and not context.is_finally:
        past = run.past.take(context.robot_name, path)
        if past is not None and (not past.is_done or (yield from _is_over(run, context, step, make, past))):
            return past.is_done
    while True:
        yield from run.admit(context)
        if not run.may_begin(context):
            return False
        action = make()
        action.path = path if is_quiet else None
        execution = _Execution(run, context, step, path, action, is_quiet)
        if (yield from execution.perform()):
            return execution.is_done


def _is_over(
    run: RunContext, context: ExecutionContext, step: FallibleStep, make: MakeAction, past: PastStep
) -> Generator[Future[Any], None, bool]:
    """Restore what a step did that an interrupted run has performed; return False to perform it again.

    Robots meet at a barrier again: the record may have lost that some of them had passed it.
    """
    for name, value in past.variables.items():
        run.assign(context, name, value)
    if step.meets_again:
        try:
            yield from make().attempt()
        except EALError:
            return False
    return True


def perform_within(
    run: RunContext,
    context: ExecutionContext,
    step: BlockStep,
    path: str,
    meets: frozenset[Hashable],
    inside: Callable[[ExecutionContext], Coroutine],
) -> Coroutine:
    """Perform the steps of a block; with a time limit, or to be repeated, the block is a step that can fail."""
    limit, repeats = step.timeout_s, isinstance(step.on_failure, RetryPolicy)
    if limit is None and not repeats:
        yield from inside(context)
        return

    def attempt(action: StepAction) -> Coroutine:
        action.began_s = run.now_s()
        timeout_s = None if limit is None else (yield from action.number(limit, "timeout", "timeout_s"))
        task = StepTask(context.task, context.slot, meets=meets, repeats=step if repeats else None)
        group = StepGroup(run, context, "all", timeout_s)
        here = replace(context, task=task, attempt=task if repeats else context.attempt)
        yield from group.perform([(task, inside(here))])
        if task.error is not None:
            raise task.error
        if group.late is not None:
            action.late = group.late if context.slot is None else ()
            raise DeadlineError(f"{step.kind} did not end within {timeout_s:g} s")

    make = partial(StepAction, run, context, step.kind, attempt)
    yield from perform_step(run, context, step, path, make, is_quiet=True)


class _Execution:
    """The execution of one step by one robot.

    Attributes:
        is_done: it has succeeded.
    """

    def __init__(
        self,
        run: RunContext,
        context: ExecutionContext,
        step: FallibleStep,
        path: str,
        action: StepAction,
        is_quiet: bool,
    ) -> None:
        self._run = run
        self._context = context
        self._step = step
        self._path = path
        self._action = action
        self._is_quiet = is_quiet
        self._robot = context.robot
        self.is_done = False
        own, attempt = step.on_failure, context.attempt
        is_inside = attempt is not None and (attempt.repeats is step or own is None)
        self._attempt = attempt if is_inside and not context.is_finally else None
        self._policy: OnFailure = "drop" if context.is_finally else context.effective_policy(own)
        self._policy = "abort" if self._attempt is not None else self._policy
        self._retries = self._policy.retry if isinstance(self._policy, RetryPolicy) else 0

    @property
    def _name(self) -> str | None:
        return self._robot.name if self._robot is not None else None

    def perform(self) -> Generator[Future[Any], None, bool]:
        """Perform the step; return False if a spare has replaced the robot and must perform it again."""
        start_s = self._run.emit(self._started) if not self._is_quiet else None
        span = self._new_span()
        steps = self._attempts()
        attempts, error = yield from (steps if span is None else spans.during(span, steps))
        if span is not None:
            span.end(error)
        if error is None:
            self.is_done = True
            if start_s is not None:
                self._record(start_s, "done", attempts, None)
            return True
        outcome = self._outcome(attempts, error)
        if start_s is None:
            start_s = self._run.emit(self._started)
        self._record(start_s, outcome, attempts if self._action.is_begun else 0, error)
        yield from self._apply(outcome, error)
        return outcome != "replaced"

    def _new_span(self) -> spans.Span | None:
        if spans.tracer is None or self._is_quiet:
            return None
        about = {"eal.step": self._path, "eal.label": self._action.label}
        if self._robot is not None:
            about["eal.robot"] = self._robot.name
        return spans.tracer.begin(f"step {self._step.kind}", about)

    def _started(self, time_s: float) -> StepStarted:
        context, action = self._context, self._action
        return StepStarted(
            time_s,
            self._name,
            self._path,
            action.label,
            context.role,
            context.branch,
            self._step.kind,
            action.resource,
            action.command,
        )

    def _attempts(self) -> Generator[Future[Any], None, tuple[int, EALError | None]]:
        attempts, robot = 0, self._robot
        while True:
            attempts += 1
            error: EALError | None = None
            losses = len(robot.losses) if robot is not None else 0
            try:
                yield from self._action.attempt()
            except WorkLimitError as caught:
                mark = self._run.main.scenario.position_of(self._path)
                error = WorkLimitError(f"{mark.file}:{mark.line}:{mark.column}: {caught.message}")
            except EALError as caught:
                error = yield from self._after_loss(caught, losses)
                if error is None:
                    continue
            if self._is_emergency(error):
                self._run.stop_for_emergency(f"emergency stop: {error}", is_finally=self._context.is_finally)
            if error is None or self._is_over() or not self._action.is_begun or attempts > self._retries:
                return attempts, error
            self._run.emit(partial(self._retried, attempts, error))
            if isinstance(self._policy, RetryPolicy) and self._policy.back_off_s:
                try:
                    yield from self._run.sleep(self._context, self._policy.pause_s(attempts))
                except CallCancelledError:
                    return attempts, error

    def _after_loss(self, error: EALError, losses: int) -> Generator[Future[Any], None, EALError | None]:
        """Apply the policy for lost robots if the robot was lost; return None to repeat the attempt.

        Args:
            error: why the attempt failed.
            losses: the number of the robot's losses before it.
        """
        robot, run = self._robot, self._run
        if robot is None or run.losses is None or not robot.losses:
            return error
        error = run.losses.cause(robot, error)
        after = None if self._is_over() else (yield from run.losses.handle(self._context, robot, error, losses))
        if after is None or self._is_over():
            return error
        if after == "repeat":
            self._retries += 1
            return None
        self._policy, self._attempt, self._retries = after, None, 0
        return error

    def _retried(self, attempt: int, error: EALError, time_s: float) -> StepRetried:
        return StepRetried(time_s, self._name, self._path, self._action.label, attempt, ErrorReport.of(error))

    def _is_over(self) -> bool:
        """Return whether no attempt may follow: the run, the task or the robot is stopped."""
        return (
            self._run.is_stopping
            or self._context.task.is_stopped
            or self._context.robot is not self._robot
            or (self._robot is not None and self._robot.outcome is not None and not self._context.is_finally)
        )

    def _is_emergency(self, error: EALError | None) -> bool:
        """Return whether a step failed because of the emergency stop of its robot."""
        is_held = self._robot is not None and self._robot.handle.stopped_because is not None
        return isinstance(error, StoppedError) or (is_held and isinstance(error, CallError))

    def _outcome(self, attempts: int, error: EALError) -> StepOutcome:
        if self._is_emergency(error):
            return "aborted"
        was_cut = isinstance(error, CallCancelledError) or attempts <= self._retries
        if self._context.robot is not self._robot and not self._run.is_stopping:
            return "replaced"
        if self._run.is_stopping and was_cut:
            return "aborted"
        if self._context.task.is_stopped and was_cut:
            return "stopped"
        if self._context.is_finally:
            return "failed"
        if self._robot is not None and self._robot.outcome is not None:
            return "dropped" if self._robot.outcome == "dropped" else "aborted"
        return self._outcome_of_policy()

    def _outcome_of_policy(self) -> StepOutcome:
        action = final_action(self._policy)
        if action == "skip":
            return "skipped"
        if action == "abort" or (self._robot is None and not self._action.late):
            return "failed"
        has_spare = action == "substitute" and self._spare() is not None
        return "replaced" if has_spare else "dropped"

    def _spare(self) -> Participant | None:
        slot = self._context.slot
        return self._run.take_spare(slot.role) if slot is not None else None

    def _record(self, start_s: float, outcome: StepOutcome, attempts: int, error: EALError | None) -> None:
        context, action = self._context, self._action

        def ended(time_s: float) -> StepEnded:
            record = StepRecord(
                robot=self._name,
                role=context.role,
                step=self._path,
                branch=context.branch,
                kind=self._step.kind,
                label=action.label,
                resource=action.resource,
                command=action.command,
                start_s=start_s if action.began_s is None else action.began_s,
                end_s=time_s,
                outcome=outcome,
                attempts=attempts,
                error=ErrorReport.of(error) if error is not None else None,
            )
            self._run.records.append(record)
            if error is not None:
                return StepEnded(time_s, record)
            return StepEnded(time_s, record, action.answer, self._run.assigned(context, assigned))

        assigned = [name for _, name in self._step.assigned()]

        self._run.emit(ended)

    def _apply(self, outcome: StepOutcome, error: EALError) -> Coroutine:
        """Apply the outcome of a failed step to its robot and to the run."""
        robot, run = self._robot, self._run
        if outcome == "failed":
            yield from self._end_failed(error)
        elif outcome == "dropped" and not self._context.is_finally:
            leaving = [one for one in (self._action.late if robot is None else [robot]) if one.outcome is None]
            for one in leaving:
                run.drop(one, error)
            yield from run.halt(leaving)
        elif outcome == "replaced" and robot is not None and robot.outcome is None:
            slot, spare = self._context.slot, self._spare()
            if slot is not None and spare is not None and not self._context.is_finally:
                run.replace(slot, spare, error)
                yield from run.halt([robot])

    def _end_failed(self, error: EALError) -> Coroutine:
        """End the attempt of the block around the step and halt its robots, or end the run."""
        if (attempt := self._attempt) is not None:
            robots = [robot for robot in dict.fromkeys(attempt.robots()) if robot.outcome is None]
            touched = attempt.touched if attempt.slot is not None and not attempt.touches_all else None
            attempt.fail(error)
            yield from self._run.halt(robots, touched)
            return
        robot, is_finally = self._robot, self._context.is_finally
        if robot is None:
            self._run.failures.append(error)
        elif not is_finally or robot.outcome in (None, "done"):
            robot.end("failed", error)
        else:
            robot.end(robot.outcome or "failed", error)
        if not is_finally:
            self._run.stop()
