"""Performs steps: one branch for each robot, a barrier at the end of each `on`, and the policies of failure."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.errors import CallCancelledError, EALError, ScenarioError, UnavailableError
from eal_actors.info import ResourceType
from eal_actors.log import get_logger
from eal_actors.scenario.calls import (
    TEXT_FIELDS,
    Action,
    AnswerStep,
    CallStep,
    RetryPolicy,
    call_fields,
    final_action,
    resolved_fields,
)
from eal_actors.scenario.events import Event, LogLine, RobotDropped, StepEnded, StepRetried, StepStarted
from eal_actors.scenario.files import save_answer
from eal_actors.scenario.loop import Branch, Loop
from eal_actors.scenario.model import ForStep, LogStep, OnStep, RepeatStep, Step, WaitStep
from eal_actors.scenario.plan import Plan
from eal_actors.scenario.report import ErrorReport, Outcome, RobotReport, StepRecord
from eal_actors.scenario.variables import substitute_text

HALT_TIMEOUT_S: Final = 2.0
"""How long the engine waits for a resource to confirm a halt: in real time, and in the fleet's where that is slower."""


@dataclass(eq=False)
class RobotRun:
    """A robot in a run.

    Attributes:
        handle: the robot.
        outcome: None while it takes part.
        error: why it failed or left.
        saved: its variables.
    """

    handle: RobotHandle
    outcome: Outcome | None = None
    error: BaseException | None = None
    saved: dict[str, object] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The robot's name."""
        return self.handle.name

    def end(self, outcome: Outcome, error: BaseException | None = None) -> None:
        """Take no part any more."""
        self.outcome = outcome
        self.error = self.error or error

    def report(self) -> RobotReport:
        """Return how it fared."""
        return RobotReport(
            outcome=self.outcome or "aborted", error=ErrorReport.of(self.error) if self.error is not None else None
        )


@dataclass(slots=True)
class _Call:
    """A call with its variables put in, or the error that kept them out."""

    resource: str
    fields: Mapping[str, Any]
    error: EALError | None
    label: str
    command: str | None


class Performer:
    """Performs the steps of one run. Everything happens in the loop's thread.

    Args:
        plan: what to do.
        robots: the robots by name.
        loop: what runs the branches.
        halt_timeout_s: how long a halt may take, in seconds of the fleet's clock.
        folder: where answers are saved; None only if none is.
        tell: told of each event; makes it from the seconds since the run's start.
        fail: told of errors that no step may have.

    Attributes:
        records: the steps that are over.
        is_stopping: nothing new is begun, and what is under way is cancelled.
    """

    def __init__(
        self,
        plan: Plan,
        robots: Mapping[str, RobotRun],
        loop: Loop,
        halt_timeout_s: float,
        folder: Path | None,
        tell: Callable[[Callable[[float], Event]], float],
        fail: Callable[[BaseException], None],
    ) -> None:
        self.records: list[StepRecord] = []
        self.is_stopping = False
        self._plan = plan
        self._file = plan.scenario.file
        self._robots = robots
        self._loop = loop
        self._halt_timeout_s = halt_timeout_s
        self._folder = folder
        self._tell = tell
        self._fail = fail
        self._is_finally = False
        self._pending: set[Future[Any]] = set()

    def steps(self) -> Branch:
        """Perform the steps."""
        return self._sequence(self._file.steps, "steps", None, {})

    def finally_steps(self) -> Branch:
        """Perform the steps of `finally`, with every robot that ever took part; failures stop nothing."""
        self._is_finally, self.is_stopping = True, False
        return self._sequence(self._file.finally_, "finally", None, {})

    def stop(self) -> None:
        """Begin nothing more, and cancel what is under way."""
        self.is_stopping = True
        for future in list(self._pending):
            future.cancel()

    def halt(self, robots: Sequence[RobotRun]) -> Branch:
        """Halt every actuator of some robots at once, and wait until they confirm it or their time is up."""
        halts = [(robot, name, halt) for robot in robots for name, halt in self._begin_halt(robot)]
        for robot, name, halt in halts:
            yield halt
            error = halt.exception()
            if error is not None:
                get_logger(robot=robot.name, resource=name).error("was not halted", reason=str(error))
                if robot.outcome != "dropped":
                    robot.end("failed", error)

    def _begin_halt(self, robot: RobotRun) -> list[tuple[str, Future[int]]]:
        halts = []
        for name, resource in robot.handle.items():
            try:
                moves = ResourceType.ACTUATOR in resource.info.types
            except UnavailableError:  # it has never been up, so it has never moved
                continue
            if moves:
                halts.append((name, resource.halt(timeout_s=self._halt_timeout_s)))
        return halts

    # Steps.

    def _goes_on(self, robot: RobotRun | None) -> bool:
        return not self.is_stopping and (robot is None or self._is_finally or robot.outcome is None)

    def _sequence(
        self, steps: Sequence[Step], path: str, robot: RobotRun | None, loops: Mapping[str, object]
    ) -> Branch:
        for index, step in enumerate(steps):
            if not self._goes_on(robot):
                return
            yield from self._perform(step, f"{path}[{index}]", robot, loops)

    def _perform(self, step: Step, path: str, robot: RobotRun | None, loops: Mapping[str, object]) -> Branch:
        if isinstance(step, CallStep) and robot is not None:
            yield from self._call(step, path, robot, loops)
        elif isinstance(step, OnStep):
            yield from self._on(step, f"{path}.do", loops)
        elif isinstance(step, ForStep | RepeatStep):
            name, values = step.loop
            for value in values:
                yield from self._sequence(step.do, f"{path}.do", robot, {**loops, name: value})
        elif isinstance(step, WaitStep):
            yield from self._until_done(self._loop.sleep(step.wait_s))
        elif isinstance(step, LogStep):
            text = substitute_text(step.log, {**(robot.saved if robot else {}), **loops})
            self._tell(lambda time_s: LogLine(time_s, robot.name if robot else None, text))

    def _until_done(self, future: Future[Any]) -> Branch:
        """Wait for a future that `stop` cancels."""
        self._pending.add(future)
        yield future
        self._pending.discard(future)

    def _on(self, step: OnStep, path: str, loops: Mapping[str, object]) -> Branch:
        """Let every robot of the role go through the steps, and wait for the last."""
        role = [self._robots[name] for name in self._plan.roles[step.on] if name not in self._plan.lost]
        robots = [robot for robot in role if self._is_finally or robot.outcome is None]
        barrier: Future[None] = Future(self._loop.clock)
        left = len(robots)

        def count(error: BaseException | None) -> None:
            nonlocal left
            if error is not None:
                self._fail(error)
            left -= 1
            if left == 0:
                barrier.set()

        for robot in robots:
            self._loop.spawn(self._sequence(step.do, path, robot, loops), count)
        if robots:
            yield barrier

    # Calls.

    def _call(self, step: CallStep, path: str, robot: RobotRun, loops: Mapping[str, object]) -> Branch:
        policy = "drop" if self._is_finally else step.on_failure or self._file.on_failure
        retries = policy.retry if isinstance(policy, RetryPolicy) else 0
        variables = {**robot.saved, **loops}
        call = _resolve(step, variables)
        start_s = self._tell(lambda time_s: StepStarted(time_s, robot.name, path, call.label))
        attempts, error = 0, call.error
        while call.error is None:
            attempts += 1
            error = yield from self._attempt(step, call, robot, variables)
            if error is None or attempts > retries or self.is_stopping:
                break
            self._tell(partial(_retried, robot.name, path, call.label, attempts, ErrorReport.of(error)))
            if isinstance(policy, RetryPolicy) and policy.back_off_s:
                yield from self._until_done(self._loop.sleep(policy.back_off_s))
                if self.is_stopping:
                    break
        outcome: Outcome = "done" if error is None else "failed"
        if self.is_stopping and error is not None and (attempts <= retries or isinstance(error, CallCancelledError)):
            outcome = "aborted"
        elif error is not None and not self._is_finally and final_action(policy) == "drop":
            outcome = "dropped"
        self._record(step, path, robot, call, start_s, outcome, attempts, error)
        if outcome in ("failed", "dropped") and error is not None:
            yield from self._give_up(robot, policy, error)

    def _attempt(
        self, step: CallStep, call: _Call, robot: RobotRun, variables: Mapping[str, object]
    ) -> Generator[Future[Any], None, EALError | None]:
        """Make the call once; return its error."""
        timeout_s = step.timeout_s or self._file.timeout_s
        try:
            method = getattr(robot.handle[call.resource], step.method)
            future: Future[Any] = method(**call.fields, timeout_s=timeout_s)
            yield from self._until_done(future)
            answer = future.get()
            if isinstance(step, AnswerStep):
                self._keep(step, robot, answer, variables)
        except EALError as error:
            return error
        return None

    def _keep(self, step: AnswerStep, robot: RobotRun, answer: object, variables: Mapping[str, object]) -> None:
        if step.save_as is not None:
            robot.saved[step.save_as] = answer
        if step.save is not None and self._folder is not None:
            name = substitute_text(step.save, variables)
            try:
                note = save_answer(answer, self._folder / robot.name, name)
            except OSError as error:
                raise ScenarioError(f"could not save {name!r}: {error}") from error
            if note is not None:
                self._tell(lambda time_s: LogLine(time_s, robot.name, note))

    def _record(
        self,
        step: CallStep,
        path: str,
        robot: RobotRun,
        call: _Call,
        start_s: float,
        outcome: Outcome,
        attempts: int,
        error: EALError | None,
    ) -> None:
        def ended(time_s: float) -> StepEnded:
            record = StepRecord(
                robot=robot.name,
                step=path,
                label=call.label,
                resource=call.resource,
                method=step.method,
                command=call.command,
                start_s=start_s,
                end_s=time_s,
                outcome=outcome,
                attempts=attempts,
                error=ErrorReport.of(error) if error is not None else None,
            )
            self.records.append(record)
            return StepEnded(time_s, record)

        self._tell(ended)

    def _give_up(self, robot: RobotRun, policy: Action | RetryPolicy, error: EALError) -> Branch:
        """Do what the policy says now that the last attempt has failed."""
        if self._is_finally:
            robot.end("failed" if robot.outcome == "done" else robot.outcome or "failed", error)
        elif final_action(policy) == "abort":
            robot.end("failed", error)
            self.stop()
        else:
            robot.end("dropped", error)
            self._tell(lambda time_s: RobotDropped(time_s, robot.name, ErrorReport.of(error)))
            if all(other.outcome is not None for other in self._robots.values()):
                self.stop()  # nobody is left to go on with
            yield from self.halt([robot])


def _retried(robot: str, step: str, label: str, attempt: int, error: ErrorReport, time_s: float) -> StepRetried:
    return StepRetried(time_s, robot, step, label, attempt, error)


def _resolve(step: CallStep, variables: Mapping[str, object]) -> _Call:
    error: EALError | None = None
    resource, fields = step.arguments.resource, call_fields(step)
    try:
        resource, fields = substitute_text(resource, variables), resolved_fields(step, variables)
    except EALError as caught:
        error = caught
    command = next((fields[name] for name in TEXT_FIELDS if name in fields), None)
    shown = [step.method, resource, *(str(value) for value in fields.values() if value is not None)]
    return _Call(resource, fields, error, " ".join(shown), command)
