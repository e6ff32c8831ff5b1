"""The execution of steps: attempts, records, failure policies, and time limits."""

from __future__ import annotations

from collections.abc import Callable, Generator, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

from eal_actors.actors.future import Future
from eal_actors.kernel import spans
from eal_actors.kernel.errors import CallCancelledError, DeadlineError, EALError, UnavailableError
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.failures import StepFailure
from eal_actors.scenario.engine.frames import AttemptMeetings, ExecutionContext, Participant, StepTask
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.engine.past_steps import PastStep
from eal_actors.scenario.language.scenario import FallibleModel, Step
from eal_actors.scenario.language.values import RetryPolicy
from eal_actors.scenario.report.events import StepEnded, StepStarted
from eal_actors.scenario.report.summary import ErrorReport, StepOutcome, StepRecord

MakeAction: TypeAlias = Callable[[], StepAction]


def perform_steps(run: RunContext, steps: Sequence[Step], path: str, context: ExecutionContext) -> Coroutine:
    """Perform steps one after the other."""
    for index, step in enumerate(steps):
        if not run.may_begin(context):
            return
        if run.losses is not None and run.losses.skips(context, step):
            record_skip(run, context, step, step.describe(context.frame.scenario.parameters), f"{path}[{index}]")
        else:
            yield from step.perform(run, context.of(step), f"{path}[{index}]")


def record_skip(run: RunContext, context: ExecutionContext, step: Step, label: str, path: str) -> None:
    """Record that a robot that was lost leaves out a step."""
    robot = context.required_robot
    error = ErrorReport(code=UnavailableError.code, message=f"{robot.name} was lost; it rejoins at its next meeting")

    def skipped(time_s: float) -> StepEnded:
        record = StepRecord(
            robot=robot.name,
            role=context.role,
            step=path,
            branch=context.branch,
            kind=step.kind,
            label=label,
            resource=None,
            command=None,
            start_s=time_s,
            end_s=time_s,
            outcome="skipped",
            attempts=0,
            error=error,
        )
        run.records.append(record)
        return StepEnded(time_s, record)

    run.emit(skipped)


def perform_step(
    run: RunContext,
    context: ExecutionContext,
    step: FallibleModel,
    path: str,
    make: MakeAction,
    *,
    is_quiet: bool = False,
) -> Generator[Future[Any], None, bool]:
    """Perform a step; if a spare replaces its robot, perform it again with the spare. Return whether it has succeeded.

    Before all that, leave it out if an interrupted run has performed it. `make` makes the action, anew for each robot;
    if it `is_quiet`, only a failure is recorded.
    """
    if run.past is not None and not is_quiet:
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
    run: RunContext, context: ExecutionContext, step: FallibleModel, make: MakeAction, past: PastStep
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
    step: FallibleModel,
    limit: float | str | None,
    path: str,
    meets: frozenset[Hashable],
    inside: Callable[[ExecutionContext], Coroutine],
) -> Coroutine:
    """Perform the steps of a block; with a time limit, or to be repeated, the block is a step that can fail."""
    repeats = isinstance(step.on_failure, RetryPolicy)
    if limit is None and not repeats:
        yield from inside(context)
        return

    meetings = AttemptMeetings()

    def attempt(action: StepAction) -> Coroutine:
        action.began_s = run.now_s()
        timeout_s = None if limit is None else (yield from action.number(limit, "timeout", "timeout_s"))
        own = meetings.begin() if repeats and context.slot is not None else None
        task = StepTask(context.task, context.slot, meets=meets, repeats=step if repeats else None, meetings=own)
        group = StepGroup(run, context, "all", timeout_s)
        here = replace(context, task=task, attempt=task if repeats else context.attempt)
        yield from group.perform([(task, inside(here))])
        action.robot = context.robot
        if task.error is not None:
            raise task.error
        if group.late is not None:
            action.late = group.late if context.slot is None else ()
            raise DeadlineError(f"{step.kind} did not end within {timeout_s:g} s")

    make = partial(StepAction, run, context, step.kind, attempt)
    yield from perform_step(run, context, step, path, make, is_quiet=True)


class StepGroup:
    """Tasks that begin together, and that another task waits for. `until` is `all`, `first` or a signal.

    `late` are the robots that were at work when the time was up; None if the tasks ended in time.
    """

    def __init__(self, run: RunContext, context: ExecutionContext, until: str, timeout_s: float | None = None) -> None:
        self.late: list[Participant] | None = None
        self._timeout_s = timeout_s
        self._run = run
        self._context = context
        self._until = until
        self._over: Future[None] = Future(run.clock)
        self._all_ended: Future[None] = Future(run.clock)
        self._left: dict[StepTask, None] = {}

    def perform(self, tasks: Sequence[tuple[StepTask, Coroutine]]) -> Coroutine:
        """Run all tasks until the condition holds; robots that are not through by then are halted."""
        if not tasks:
            return
        run, parent = self._run, self._context.task
        for task, _ in tasks:
            self._left[task] = None
            parent.children[task] = None
        for task, _ in tasks:
            run.barriers.enter(task)
        frame, signal = self._context.frame, None
        if self._until not in ("all", "first"):
            signal = run.signals.wait(frame, self._until)
            signal.add_done_callback(lambda _: self._over.set())
        for task, coroutine in tasks:
            run.loop.spawn(coroutine, partial(self._ended, task))
        if self._timeout_s is None:
            yield self._over
        else:
            yield from self._wait_within(self._timeout_s)
        if signal is not None:
            run.signals.withdraw(frame, self._until, signal)
        if self._left:
            yield from self._stop_rest()

    def _wait_within(self, timeout_s: float) -> Coroutine:
        """Wait until they are over, or the time is up; it starts anew for a spare that takes over."""
        run, context = self._run, self._context
        robot, end_s = context.robot, run.pauses.active_s() + timeout_s
        while True:
            try:
                if (yield from run.wait_within(context, self._over, end_s - run.pauses.active_s())):
                    return
                break
            except CallCancelledError:
                if not run.may_begin(context):  # they are being stopped as well
                    yield self._over
                    return
            if context.robot is not robot:
                robot, end_s = context.robot, run.pauses.active_s() + timeout_s
        robots = dict.fromkeys(robot for task in self._left for robot in task.robots())
        self.late = [robot for robot in robots if self._is_at_work(robot)]

    def _ended(self, task: StepTask, error: BaseException | None) -> None:
        run = self._run
        self._left.pop(task, None)
        self._context.task.children.pop(task, None)
        run.barriers.leave(task)
        if error is not None:
            run.fail(error)
        if not self._left:
            self._over.set()
            self._all_ended.set()
        elif self._until == "first" and self._is_through(task):
            self._over.set()

    def _is_through(self, task: StepTask) -> bool:
        """Return whether a task has performed all of its steps, and was not cut short."""
        if task.is_stopped or self._run.is_stopping:
            return False
        return task.slot is None or self._is_at_work(task.slot.robot)

    def _is_at_work(self, robot: Participant) -> bool:
        """Return whether a robot has not left the run; in `finally` all take part."""
        return self._context.is_finally or robot.outcome is None

    def _stop_rest(self) -> Coroutine:
        tasks = list(self._left)
        slot = self._context.slot
        robots = dict.fromkeys([slot.robot] if slot else [robot for task in tasks for robot in task.robots()])
        for task in tasks:
            task.stop()
        if self._left:
            yield self._all_ended
        touched: dict[str, None] | None = None
        if slot is not None and not any(task.touches_all for task in tasks):  # the robot's other branches continue
            touched = {name: None for task in tasks for name in task.touched}
        yield from self._run.halt([robot for robot in robots if self._is_at_work(robot)], touched)


@dataclass(eq=False)
class _Execution:
    """The execution of one step by one robot."""

    _run: RunContext
    _context: ExecutionContext
    _step: FallibleModel
    _path: str
    _action: StepAction
    _is_quiet: bool
    is_done: bool = False

    @property
    def _name(self) -> str | None:
        return self._action.robot.name if self._action.robot is not None else None

    def perform(self) -> Generator[Future[Any], None, bool]:
        """Perform the step; return False if a spare has replaced the robot and must perform it again."""
        start_s = self._run.emit(self._started) if not self._is_quiet else None
        span = self._new_span()
        steps = self._attempts()
        attempts, failure = yield from (steps if span is None else spans.during(span, steps))
        if span is not None:
            span.end(failure.error if failure is not None else None)
        if failure is None:
            self.is_done = True
            if start_s is not None:
                self._record(start_s, "done", attempts, None)
            return True
        outcome = failure.outcome(attempts)
        if start_s is None:
            start_s = self._run.emit(self._started)
        self._record(start_s, outcome, attempts if self._action.is_begun else 0, failure.error)
        yield from failure.apply(outcome)
        return outcome != "replaced"

    def _new_span(self) -> spans.Span | None:
        if spans.tracer is None or self._is_quiet:
            return None
        about = {"eal.step": self._path, "eal.label": self._action.label}
        if self._name is not None:
            about["eal.robot"] = self._name
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

    def _attempts(self) -> Generator[Future[Any], None, tuple[int, StepFailure | None]]:
        attempts, action = 0, self._action
        failure: StepFailure | None = None
        while True:
            attempts += 1
            losses = len(action.robot.losses) if action.robot is not None else 0
            try:
                yield from action.attempt()
            except EALError as caught:
                error = caught
            else:
                return attempts, None
            if failure is None:
                failure = StepFailure(self._step, self._path, action, error)
            if not (yield from failure.repeats(error, attempts, losses)):
                return attempts, failure

    def _record(self, start_s: float, outcome: StepOutcome, attempts: int, error: EALError | None) -> None:
        context, action = self._context, self._action

        def ended(time_s: float) -> StepEnded:
            began_s = start_s if action.began_s is None else action.began_s
            record = StepRecord(
                robot=self._name,
                role=context.role if action.role is None else action.role,
                step=self._path,
                branch=context.branch,
                kind=self._step.kind,
                label=action.label,
                resource=action.resource,
                command=action.command,
                start_s=min(began_s, time_s),  # the agreed time of a command that failed before it is still to come
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
