"""What all steps of a run share: robots, records, time, and the ways to wait, to stop and to halt."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Generator, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.device.info import ResourceType
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import UnavailableError
from eal_actors.kernel.log import get_logger
from eal_actors.scenario.engine.cast import Context, RobotRun, Seat, Unit
from eal_actors.scenario.engine.loop import Branch, Loop
from eal_actors.scenario.engine.meetings import Meetings
from eal_actors.scenario.engine.pace import Pace
from eal_actors.scenario.engine.signals import Signals
from eal_actors.scenario.events import Event, LogLine, RobotDropped, RobotReplaced
from eal_actors.scenario.expressions import Expression, Known, Reading
from eal_actors.scenario.plan import Plan
from eal_actors.scenario.report import ErrorReport, StartReport, StepRecord

T = TypeVar("T")
Tell = Callable[[Callable[[float], Event]], float]
"""Told of each event; makes it from the seconds since the run's start, which it returns."""

HALT_TIMEOUT_S: Final = 2.0
"""How long the engine waits for a resource to confirm a halt: in real time, and in the fleet's where that is slower."""
_SHORTEST_LOOK_S: Final = 0.05
_STEPS_AT_ONCE: Final = 20
_STEPS_AT_ONCE_EACH: Final = 2
_STEP_S: Final = 0.001
"""On a clock that jumps, so many steps, and so many more for each robot, may begin while time stands still; then a
little time passes, as it would on any other clock, or deadlines would be the next thing to happen."""


class Stage:
    """The state of one run. Everything happens in the loop's thread.

    Args:
        plan: what to do.
        robots: the robots by name.
        loop: what runs the branches.
        seed: of the fleet.
        folder: where answers are saved; None only if none is.
        tell: told of each event.
        fail: told of errors that no step may have.

    Attributes:
        records: the steps that are over.
        starts: the starts together that are over.
        failures: why steps of no robot ended the run.
        is_stopping: nothing new is begun, and what is under way is cancelled.
        seats: the places of each role of the main scenario.
        main: the main scenario.
        substitutes: of robots that did not start, the spare that sits in their place, and its role.
        threads: those of Python steps.
        zero_s: when the run began, by the fleet's clock.
        open_units: the scenarios under way as parts of others, with where they stand.
    """

    def __init__(
        self,
        plan: Plan,
        robots: Mapping[str, RobotRun],
        loop: Loop,
        seed: int,
        folder: Path | None,
        tell: Tell,
        fail: Callable[[BaseException], None],
    ) -> None:
        self.plan = plan
        self.robots = robots
        self.loop = loop
        self.clock: Clock = loop.clock
        self.seed = seed
        self.folder = folder
        self.tell = tell
        self.fail = fail
        self.records: list[StepRecord] = []
        self.starts: list[StartReport] = []
        self.failures: list[BaseException] = []
        self.is_stopping = False
        self.pace = Pace(self.clock, tell)
        self.meetings = Meetings(self.clock)
        self.signals = Signals(self.clock)
        scenario = plan.scenario
        self.main = Unit(scenario, {role: role for role in scenario.file.roles}, scenario.parameters)
        self.open_units: list[Context] = []
        self.seats: dict[str, list[Seat]] = {}
        self._halt_timeout_s = max(HALT_TIMEOUT_S, self.clock.of_real(HALT_TIMEOUT_S))
        self.zero_s = 0.0
        self.substitutes: dict[str, tuple[str, str]] = {}
        self.threads: list[threading.Thread] = []
        self._pending: dict[Future[Any], None] = {}
        self._step_at_s = 0.0
        self._steps_at_once = 0

    def now_s(self) -> float:
        """Return the seconds since the run's start."""
        return self.clock.now() - self.zero_s

    # Robots.

    def handles(self, context: Context) -> dict[str, RobotHandle]:
        """Return the robots that a step may use."""
        if context.robot is not None:
            return {context.robot.name: context.robot.handle}
        return {name: robot.handle for name, robot in self.robots.items() if robot.outcome is None}

    def live_seats(self, role: str) -> list[Seat]:
        """Return the places of a role whose robots take part."""
        return [seat for seat in self.seats[role] if seat.robot.outcome is None]

    def take_spare(self, role: str) -> RobotRun | None:
        """Return a robot kept in reserve for a role, or None if none is left."""
        for name in self.plan.spares.get(role, ()):
            robot = self.robots[name]
            if robot.outcome is None and not robot.is_seated and name not in self.plan.lost:
                return robot
        return None

    def replace(self, seat: Seat, spare: RobotRun, error: BaseException) -> None:
        """Let a spare take a robot's place; the robot takes part no more."""
        old = seat.robot
        seat.past.append(old)
        seat.robot, spare.is_seated = spare, True
        old.end("replaced", error)
        self.tell(lambda time_s: RobotReplaced(time_s, old.name, spare.name, seat.role, ErrorReport.of(error)))
        self._leave(old)

    def drop(self, robot: RobotRun, error: BaseException) -> None:
        """Go on without a robot, as long as its roles have enough others."""
        robot.end("dropped", error)
        self.tell(lambda time_s: RobotDropped(time_s, robot.name, ErrorReport.of(error)))
        self._leave(robot)

    def _leave(self, robot: RobotRun) -> None:
        for future in list(robot.pending):
            future.cancel()
        for role, seats in self.seats.items():
            live, needed = len(self.live_seats(role)), self.plan.scenario.file.roles[role].min
            if any(seat.robot is robot for seat in seats) and live < needed:
                self.log(None, f"role '{role}' is left with {live} of the {needed} robots that it needs")
                self.stop()
        if self.robots and all(other.outcome is not None or not other.is_seated for other in self.robots.values()):
            self.stop()  # nobody is left to go on with

    # Words.

    def log(self, robot: str | None, text: str) -> None:
        """Tell those who watch."""
        self.tell(lambda time_s: LogLine(time_s, robot, text))

    # Going on and stopping.

    def goes_on(self, context: Context) -> bool:
        """Return whether the next step of a line may begin."""
        if self.is_stopping or context.task.is_stopped:
            return False
        robot = context.robot
        return robot is None or context.is_finally or robot.outcome is None

    def stop(self) -> None:
        """Begin nothing more, and cancel what is under way."""
        self.is_stopping = True
        self.pace.open_for_end()
        for future in list(self._pending):
            future.cancel()

    def admit(self, context: Context) -> Branch:
        """Wait until the next step may begin, as far as pauses go."""
        while not context.is_finally and self.goes_on(context) and not self.pace.admits(context.task):
            yield from self.wait(context, self.pace.change())
        now_s = self.clock.now()
        self._steps_at_once = self._steps_at_once + 1 if now_s == self._step_at_s else 1
        self._step_at_s = now_s
        if self._steps_at_once > _STEPS_AT_ONCE + _STEPS_AT_ONCE_EACH * len(self.robots):
            yield from self.wait(context, self.loop.sleep(_STEP_S))

    # Waiting.

    def wait(self, context: Context, future: Future[Any]) -> Branch:
        """Wait for a future that is cancelled when the run, the line or the robot is stopped."""
        robot = context.robot
        holders = [self._pending, context.task.pending, *([robot.pending] if robot is not None else [])]
        for pending in holders:
            pending[future] = None
        if self.is_stopping or context.task.is_stopped:
            future.cancel()
        try:
            yield future
        finally:
            for pending in holders:
                pending.pop(future, None)

    def wait_within(self, context: Context, future: Future[T], timeout_s: float) -> Generator[Future[Any], None, bool]:
        """Wait for a future at most so long, pauses aside; return whether it is done.

        Raises:
            CallCancelledError: the run, the line or the robot was stopped.
        """
        end_s = self.pace.active_s() + timeout_s
        while not future.done():
            left_s = end_s - self.pace.active_s()
            if left_s <= 1e-9:
                return False
            either: Future[None] = Future(self.clock)
            future.add_done_callback(lambda _, done=either: done.set())  # type: ignore[misc]  # a default binds it now
            look_s = max(left_s, _SHORTEST_LOOK_S) if self.pace.is_paused else left_s
            timer = self.loop.call_at(self.clock.now() + look_s, either.set)
            try:
                yield from self.wait(context, either)
                either.get()
            finally:
                timer.cancel()
        return True

    def sleep(self, context: Context, duration_s: float) -> Branch:
        """Let time pass.

        Raises:
            CallCancelledError: the run, the line or the robot was stopped.
        """
        future = self.loop.sleep(duration_s)
        yield from self.wait(context, future)
        future.get()

    # Expressions.

    def known(self, context: Context, readings: Mapping[Reading, object] | None = None) -> Known:
        """Return what expressions of a step can refer to."""
        unit, seat = context.unit, context.seat
        variables: dict[str, object] = {**unit.variables, "run": {"seed": self.seed}}
        if seat is not None:
            variables |= seat.variables_in(unit)
            variables |= seat.facts(context.role or seat.role, unit)
        variables |= context.loops
        return Known(variables, readings or {})

    def read(
        self, context: Context, expressions: Iterable[Expression], timeout_s: float | None = None
    ) -> Generator[Future[Any], None, Known]:
        """Ask the robot for what expressions need; return what they can refer to.

        Raises:
            EALError: a reading failed.
        """
        wanted = dict.fromkeys(reading for expression in expressions for reading, _ in expression.readings)
        if not wanted:
            return self.known(context)
        robot = context.acting
        calls: list[tuple[Reading, Future[Any]]] = []
        for reading in wanted:
            method = getattr(robot.handle[reading.resource], reading.method)
            given = [] if reading.argument is None else [reading.argument]
            calls.append((reading, method(*given, timeout_s=timeout_s or context.unit.timeout_s)))
        answers: dict[Reading, object] = {}
        for reading, call in calls:
            yield from self.wait(context, call)
            answers[reading] = call.get()
        return self.known(context, answers)

    def assign(self, context: Context, name: str, value: object) -> None:
        """Give a variable a value: the seat's inside an `on`, the run's outside."""
        unit, seat = context.unit, context.seat
        (unit.variables if seat is None else seat.variables_in(unit))[name] = value

    # Halting.

    def halt(self, robots: Sequence[RobotRun], only: Collection[str] | None = None) -> Branch:
        """Halt every actuator of some robots, or only these, at once; wait until they confirm it or time is up."""
        halts = [(robot, name, halt) for robot in robots for name, halt in self._begin_halt(robot, only)]
        for robot, name, halt in halts:
            yield halt
            error = halt.exception()
            if error is not None:
                get_logger(robot=robot.name, resource=name).error("was not halted", reason=str(error))
                if robot.outcome not in ("dropped", "replaced"):
                    robot.end("failed", error)

    def _begin_halt(self, robot: RobotRun, only: Collection[str] | None) -> list[tuple[str, Future[int]]]:
        halts: list[tuple[str, Future[int]]] = []
        for name, resource in robot.handle.items():
            if only is not None and name not in only:
                continue
            try:
                moves = ResourceType.ACTUATOR in resource.info.types
            except UnavailableError:  # it has never been up, so it has never moved
                continue
            if moves:
                halts.append((name, resource.halt(timeout_s=self._halt_timeout_s)))
        return halts
