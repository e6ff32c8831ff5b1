"""The state of a run that all steps share: robots, records, time, and the ways to wait, to stop and to halt."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Generator, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeVar

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import ROUNDING_S, Clock
from eal_actors.kernel.log import get_logger
from eal_actors.scenario.engine.frames import ExecutionContext, Frame, Participant, RoleSlot
from eal_actors.scenario.engine.loop import Coroutine, EventLoop
from eal_actors.scenario.engine.losses import Emit, Losses
from eal_actors.scenario.engine.past_steps import PastSteps
from eal_actors.scenario.engine.plan import Plan
from eal_actors.scenario.engine.synchronization import Barriers, PauseControl, Signals
from eal_actors.scenario.language.expressions.evaluation import Namespace, WorkBudget, WorkLimitError, size_of
from eal_actors.scenario.language.expressions.grammar import Expression, RobotReading
from eal_actors.scenario.report.events import LogLine, Readings, RobotDropped, RobotReplaced
from eal_actors.scenario.report.records import is_recordable, to_record, whole_text
from eal_actors.scenario.report.summary import ErrorReport, StartReport, StepRecord

T = TypeVar("T")
HALT_TIMEOUT_S: Final = 2.0
"""How long the engine waits for the confirmation of a halt: in real time, or in the fleet's if that is slower."""
_PASSES_AT_ONCE: Final = 200
_WORK_AT_ONCE: Final = 200_000
"""After so many passes of loops, or so much work of expressions, other tasks run, even if nothing had to wait."""
_MAX_WORK: Final = 50_000_000
_MAX_WORK_EACH_S: Final = 20_000
"""Maximum work of the expressions of a run, and in addition for each robot and second of the fleet's clock."""
_MAX_KEPT: Final = 2_000_000
"""Maximum size of all variables of a run together."""
_STEPS_AT_ONCE: Final = 20
_STEPS_AT_ONCE_EACH: Final = 2
_STEP_S: Final = 0.001
"""On a clock that jumps, so many steps, and so many more for each robot, may begin at the same time. Then a little time
passes, as on any other clock. Otherwise the next thing to happen would be the deadlines."""


class RunContext:
    """The state of one run. Everything runs in the loop's thread.

    `folder` is that of saved answers; None only if none is saved.

    Attributes:
        losses: the robots that are out of reach; None without robots of other processes.
        failures: the errors of steps outside of `on` that ended the run.
        is_stopping: no step begins, and those under way are cancelled.
        is_short: a role has fewer robots than it needs, or no robot is left.
        slots: the slots of each role of the main scenario.
        substitutes: for robots that did not start, the spare in their slot, and its role.
        zero_s: the start of the run, by the fleet's clock.
        past: the steps of an interrupted block that were over; None if no run was interrupted, or it is repeated.
        keeps_files: whether the files outlive the run.
        open_parts: the scenarios under way as parts of others, with their contexts.
        emergency: the reason of an emergency stop that ended the run; None without one.
    """

    def __init__(
        self,
        plan: Plan,
        robots: Mapping[str, Participant],
        loop: EventLoop,
        fleet: Fleet,
        folder: Path | None,
        emit: Emit,
        fail: Callable[[BaseException], None],
    ) -> None:
        self.plan = plan
        self.robots = robots
        self.loop = loop
        self.clock: Clock = loop.clock
        self.fleet = fleet
        self.seed = fleet.config.seed
        self.folder = folder
        self.emit = emit
        self.fail = fail
        self.records: list[StepRecord] = []
        self.starts: list[StartReport] = []
        self.failures: list[BaseException] = []
        self.is_stopping = self.is_short = False
        self.emergency: str | None = None
        self.pauses = PauseControl(self.clock, emit)
        self.barriers = Barriers(self.clock)
        self.signals = Signals(self.clock)
        scenario, sections = plan.scenario, fleet.config.robots
        remote = [one for name, one in robots.items() if name in sections and sections[name].address is not None]
        self.losses = self._watch(remote) if remote else None
        self.main = Frame(scenario, {role: role for role in scenario.file.roles}, dict(scenario.parameters))
        self.past: PastSteps | None = None
        self.open_parts: list[ExecutionContext] = []
        self.slots: dict[str, list[RoleSlot]] = {}
        self.zero_s, self.keeps_files = 0.0, True
        self.substitutes: dict[str, tuple[str, str]] = {}
        self.threads: list[threading.Thread] = []
        self._halt_timeout_s = max(HALT_TIMEOUT_S, self.clock.of_real(HALT_TIMEOUT_S))
        self._pending: dict[Future[Any], None] = {}
        self._step_at_s = 0.0
        self._steps_at_once = self._passes = self._kept = 0
        self.budget = WorkBudget(
            "the expressions of this run", _MAX_WORK, lambda: _MAX_WORK_EACH_S * len(robots) * self.now_s()
        )
        self._pause_at_work = _WORK_AT_ONCE

    def _watch(self, remote: Sequence[Participant]) -> Losses:
        network, own_s = self.fleet.config.network, self.plan.scenario.file.lost_after_s
        real_s = network.lease_s if network.lost_after_s is None else network.lost_after_s
        lost_after_s = self.clock.of_real(real_s) if own_s is None else own_s
        there = [robot for robot in remote if robot.name not in self.plan.lost]
        return Losses(there, lost_after_s, self.loop, self.emit, self.wait)

    def now_s(self) -> float:
        """Return the seconds since the run's start."""
        return self.clock.now() - self.zero_s

    def log(self, robot: str | None, text: str) -> None:
        """Send a line of text to the listeners."""
        self.emit(lambda time_s: LogLine(time_s, robot, whole_text(text)))

    # Robots.

    def handles(self, context: ExecutionContext) -> dict[str, RobotHandle]:
        """Return the robots that a step may use; in `finally`, every robot that ever took part."""
        if context.robot is not None:
            return {context.robot.name: context.robot.handle}
        return {
            name: robot.handle
            for name, robot in self.robots.items()
            if (robot.has_taken_part if context.is_finally else robot.outcome is None)
        }

    def slots_of(self, role: str, context: ExecutionContext) -> list[RoleSlot]:
        """Return the slots whose robots perform an `on`; in `finally`, a slot for every robot that ever took part."""
        frame = context.frame
        slots = [frame.slot] if frame.slot is not None else self.slots[frame.roles[role]]
        if not context.is_finally:
            return [slot for slot in slots if slot.robot.outcome is None]
        return [
            replace(slot, robot=robot) if robot is not slot.robot else slot
            for slot in slots
            for robot in (*slot.past, slot.robot)
        ]

    def take_spare(self, role: str) -> Participant | None:
        """Return a robot in reserve for a role, or None if none is left."""
        for name in self.plan.spares.get(role, ()):
            robot = self.robots[name]
            if robot.outcome is None and not robot.has_taken_part and name not in self.plan.lost:
                return robot
        return None

    def replace(self, slot: RoleSlot, spare: Participant, error: BaseException) -> None:
        """Put a spare into the slot of a robot, which leaves the run."""
        old = slot.robot
        slot.past.append(old)
        slot.robot, spare.has_taken_part = spare, True
        old.end("replaced", error)
        self.emit(lambda time_s: RobotReplaced(time_s, old.name, spare.name, slot.role, ErrorReport.of(error)))
        self._leave(old)

    def drop(self, robot: Participant, error: BaseException) -> None:
        """Continue without a robot, as long as its roles have enough others."""
        robot.end("dropped", error)
        self.emit(lambda time_s: RobotDropped(time_s, robot.name, ErrorReport.of(error)))
        self._leave(robot)

    def _leave(self, robot: Participant) -> None:
        for future in list(robot.pending):
            future.cancel()
        for role, slots in self.slots.items():
            live = sum(slot.robot.outcome is None for slot in slots)
            needed = self.plan.scenario.file.roles[role].min
            if any(slot.robot is robot for slot in slots) and live < needed:
                self.log(None, f"role '{role}' is left with {live} of the {needed} robots that it needs")
                self.is_short = True
                self.stop()
        if self.robots and all(other.outcome is not None or not other.has_taken_part for other in self.robots.values()):
            self.is_short = True  # no robot is left
            self.stop()

    def errors(self) -> list[BaseException | None]:
        """Return the errors that make the run fail: dropped robots count if too few are left."""
        bad = {"failed", "dropped" if self.is_short else "failed"}
        return [*(robot.error for robot in self.robots.values() if robot.outcome in bad), *self.failures]

    # Admission of steps.

    def may_begin(self, context: ExecutionContext) -> bool:
        """Return whether the next step of a task may begin."""
        if self.is_stopping or context.task.is_stopped:
            return False
        robot = context.robot
        return robot is None or context.is_finally or robot.outcome is None

    def stop(self) -> None:
        """Begin no more steps, and cancel those under way."""
        self.is_stopping = True
        self.pauses.end()
        for future in list(self._pending):
            future.cancel()

    def stop_for_emergency(self, reason: str, *, is_finally: bool) -> None:
        """Stop the run, because an emergency stop holds a robot; `finally` still runs."""
        self.emergency = self.emergency or reason
        if not is_finally:
            self.stop()

    def admit(self, context: ExecutionContext) -> Coroutine:
        """Wait until pauses allow the next step."""
        while not context.is_finally and self.may_begin(context) and not self.pauses.admits(context.task):
            yield from self.wait(context, self.pauses.change())
        now_s = self.clock.now()
        self._steps_at_once = self._steps_at_once + 1 if now_s == self._step_at_s else 1
        self._step_at_s = now_s
        if self._steps_at_once > _STEPS_AT_ONCE + _STEPS_AT_ONCE_EACH * len(self.robots):
            yield from self.wait(context, self.loop.sleep(_STEP_S))
        if self.budget.spent > self._pause_at_work:
            self._pause_at_work = self.budget.spent + _WORK_AT_ONCE
            yield self.loop.checkpoint()

    def next_pass(self) -> Coroutine:
        """Let other tasks run every so many passes of loops."""
        self._passes += 1
        if self._passes % _PASSES_AT_ONCE == 0:
            yield self.loop.checkpoint()

    # Waiting.

    def wait(self, context: ExecutionContext, future: Future[Any]) -> Coroutine:
        """Wait for a future; it is cancelled when the run, the task or the robot is stopped."""
        robot = context.robot
        holders: list[dict[Future[Any], Any]] = [self._pending, context.task.pending]
        holders += [robot.pending] if robot is not None else []
        for pending in holders:
            pending[future] = context.lost_after_s
        if self.is_stopping or context.task.is_stopped:
            future.cancel()
        try:
            yield future
        finally:
            for pending in holders:
                pending.pop(future, None)

    def wait_within(
        self, context: ExecutionContext, future: Future[T], timeout_s: float
    ) -> Generator[Future[Any], None, bool]:
        """Wait for a future for a limited time, not counting pauses; return whether it is done.

        Raises CallCancelledError if the run, the task or the robot was stopped.
        """
        end_s = self.pauses.active_s() + timeout_s
        while not future.done():
            left_s = end_s - self.pauses.active_s()
            if left_s <= ROUNDING_S:
                return False
            either: Future[None] = Future(self.clock)
            future.add_done_callback(lambda _, done=either: done.set())  # type: ignore[misc]  # a default binds it now
            if self.pauses.is_paused:
                self.pauses.change().add_done_callback(lambda _, done=either: done.set())  # type: ignore[misc]
            else:
                timer = self.loop.call_at(self.clock.now() + left_s, either.set)
                either.add_done_callback(lambda _, timer=timer: timer.cancel())  # type: ignore[misc]
            yield from self.wait(context, either)
            either.get()
        return True

    def sleep(self, context: ExecutionContext, duration_s: float) -> Coroutine:
        """Wait for a time; raise CallCancelledError if the run, the task or the robot was stopped."""
        future = self.loop.sleep(duration_s)
        yield from self.wait(context, future)
        future.get()

    # Expressions.

    def namespace(self, context: ExecutionContext, readings: Mapping[RobotReading, object] | None = None) -> Namespace:
        """Return the variables and readings for the expressions of a step."""
        frame, slot = context.frame, context.slot
        variables: dict[str, object] = {**frame.variables, "run": {"seed": self.seed}}
        if slot is not None:
            variables |= slot.variables_in(frame)
            variables |= slot.facts(context.role or slot.role, frame)
        variables |= context.loops
        return Namespace(variables, readings or {})

    def read(
        self, context: ExecutionContext, expressions: Iterable[Expression], *, path: str | None = None
    ) -> Generator[Future[Any], None, Namespace]:
        """Call the robot for the readings in expressions; return their namespace; raise EALError if a reading failed.

        With a path, the values are kept in the record under it, and those of an interrupted run are taken.
        """
        wanted = dict.fromkeys(reading for expression in expressions for reading, _ in expression.readings)
        if not wanted:
            return self.namespace(context)
        if path is not None and self.past is not None:
            past = self.past.take_readings(context.robot_name, path, wanted)
            if len(past) == len(wanted):
                return self.namespace(context, past)
        robot = context.required_robot
        calls: list[tuple[RobotReading, Future[Any]]] = []
        for reading in wanted:
            method = getattr(robot.handle[reading.resource], reading.method)
            given = [] if reading.argument is None else [reading.argument]
            calls.append((reading, method(*given, timeout_s=context.frame.timeout_s)))
        answers: dict[RobotReading, object] = {}
        for reading, call in calls:
            yield from self.wait(context, call)
            answers[reading] = call.get()
        if path is not None and self.folder is not None:
            values = {str(reading): to_record(value) for reading, value in answers.items() if is_recordable(value)}
            self.emit(lambda time_s: Readings(time_s, robot.name, path, values))
        return self.namespace(context, answers)

    def assigned(self, context: ExecutionContext, names: Iterable[str | None]) -> dict[str, object]:
        """Return those of some variables that are assigned, without the names that are None."""
        frame, slot = context.frame, context.slot
        variables = frame.variables if slot is None else slot.variables_in(frame)
        return {name: variables[name] for name in names if name is not None and name in variables}

    def has_met_before(self, context: ExecutionContext, path: str) -> bool:
        """Return whether all robots had come to an interrupted step with `together`, so that none waits again."""
        if self.past is None or context.role is None:
            return False
        others = [slot.robot.name for slot in self.slots_of(context.role, context)]
        return self.past.had_met(path, context.required_robot.name, others)

    def assign(self, context: ExecutionContext, name: str | None, value: object) -> None:
        """Assign a variable, if there is a name: of the slot inside an `on`, of the run outside.

        Raises WorkLimitError if the variables of the run are too large together.
        """
        frame, slot = context.frame, context.slot
        if name is not None:
            variables = frame.variables if slot is None else slot.variables_in(frame)
            self._keep(size_of(value) - (size_of(variables[name]) if name in variables else 0))
            variables[name] = value

    def keep(self, variables: Mapping[str, object]) -> None:
        """Count the parameters of a scenario that begins; raise WorkLimitError if the run's variables are too large."""
        self._keep(sum(map(size_of, variables.values())))

    def forget(self, frame: Frame) -> None:
        """Forget the variables of a scenario that is over."""
        slots = [slot.part_variables.pop(frame, {}) for slots in self.slots.values() for slot in slots]
        self._keep(-sum(size_of(value) for variables in (frame.variables, *slots) for value in variables.values()))
        self.signals.forget(frame)

    def _keep(self, more: int) -> None:
        if more > 0 and self._kept + more > _MAX_KEPT:
            raise WorkLimitError(f"the variables of this run hold more than {_MAX_KEPT} items and characters")
        self._kept += more

    # Halting.

    def halt(self, robots: Sequence[Participant], only: Collection[str] | None = None) -> Coroutine:
        """Halt all actuators of some robots, or only these, and wait for the confirmations or the timeout."""
        halts = [(robot, name, halt) for robot in robots for name, halt in robot.begin_halt(self._halt_timeout_s, only)]
        for robot, name, halt in halts:
            yield halt
            error = halt.exception()
            if error is not None:
                get_logger(robot=robot.name, resource=name).error("was not halted", reason=str(error))
                if robot.outcome not in ("dropped", "replaced"):
                    robot.end("failed", error)
