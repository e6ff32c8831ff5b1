"""Lost robots: their steps under way fail after a while, and their role may wait until they are back."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, Literal, TypeAlias

from eal_actors.actors.future import Future
from eal_actors.actors.robot_view import RobotState
from eal_actors.actors.stop_latch import SERVICE_ENDS
from eal_actors.kernel.clock import Timer
from eal_actors.kernel.errors import CallCancelledError, EALError, UnavailableError
from eal_actors.scenario.engine.frames import ExecutionContext, Participant
from eal_actors.scenario.engine.loop import Coroutine, EventLoop
from eal_actors.scenario.engine.synchronization import find_meetings
from eal_actors.scenario.language.scenario import Step
from eal_actors.scenario.language.values import FailureAction, LossAction, WaitPolicy
from eal_actors.scenario.report.events import RobotLost, RobotReturned, RunEvent
from eal_actors.scenario.report.summary import ErrorReport, LossReport

_LEAVE_S: Final = 5.0
"""Real seconds in which a server that is being stopped has left the network."""

Emit: TypeAlias = Callable[[Callable[[float], RunEvent]], float]
"""Records an event, which it makes from the seconds since the run's start; returns those seconds."""
Wait: TypeAlias = Callable[[ExecutionContext, Future[Any]], Coroutine]

_ACTIONS: Final[dict[LossAction, FailureAction]] = {"fail": "abort", "drop": "drop", "substitute": "substitute"}


@dataclass(eq=False)
class Losses:
    """The robots of other processes that are out of reach. Everything but `_hear` runs in the loop's thread.

    A robot out of reach for `lost_after_s`, by the fleet's clock, fails its step.
    """

    _robots: Collection[Participant]
    _lost_after_s: float
    _loop: EventLoop
    _emit: Emit
    _wait: Wait
    _lost_at_s: dict[str, float] = field(default_factory=dict, init=False)
    _timers: dict[str, Timer] = field(default_factory=dict, init=False)
    _waiting: dict[Future[None], Participant] = field(default_factory=dict, init=False)

    def watched(self, steps: Coroutine) -> Coroutine:
        """Perform steps, and follow the robots meanwhile."""
        with ExitStack() as stack:
            for robot in self._robots:
                stack.callback(robot.handle.on_state(partial(self._hear, robot)))
            yield from steps

    def _hear(self, robot: Participant, state: RobotState) -> None:
        """Pass a state on to the loop. Thread: the robot's."""
        self._loop.post(lambda: self._note(robot, state))

    def _note(self, robot: Participant, state: RobotState) -> None:
        if state is RobotState.LOST and not robot.is_lost:
            error = ErrorReport.of(self._error(robot))
            lost_s = self._emit(lambda time_s: RobotLost(time_s, robot.name, error))
            robot.losses.append(LossReport(lost_s=lost_s))
            self._lost_at_s[robot.name] = self._loop.clock.now()
            self._give_up(robot)
        elif state is RobotState.READY and robot.is_lost:
            back_s = self._emit(lambda time_s: RobotReturned(time_s, robot.name))
            robot.losses[-1] = robot.losses[-1].model_copy(update={"back_s": back_s})
            robot.is_given_up = False
            if (timer := self._timers.pop(robot.name, None)) is not None:
                timer.cancel()
        for future in [future for future, waiting in self._waiting.items() if waiting is robot]:
            future.set()

    def _error(self, robot: Participant) -> EALError:
        problems = robot.handle.problems
        return problems[-1] if problems else UnavailableError("is out of reach", robot=robot.name)

    def _limit_s(self, robot: Participant, own_s: float | None) -> float:
        """Return when a step of a lost robot fails, by the fleet's clock."""
        return self._lost_at_s[robot.name] + (self._lost_after_s if own_s is None else own_s)

    def _give_up(self, robot: Participant) -> None:
        """Fail the steps under way of a robot that is lost for longer than they allow, and come back for the others."""
        pending = [(future, own_s) for future, own_s in robot.pending.items() if future not in self._waiting]
        limits = {future: self._limit_s(robot, own_s) for future, own_s in pending}
        now_s = self._loop.clock.now()
        later = [limit_s for limit_s in (*limits.values(), self._limit_s(robot, None)) if limit_s > now_s]
        if later:
            self._timers[robot.name] = self._loop.call_at(min(later), partial(self._give_up, robot))
        for future, limit_s in limits.items():
            if limit_s <= now_s:
                robot.is_given_up = True
                future.cancel()

    def cause(self, robot: Participant, error: EALError) -> EALError:
        """Return the loss of the robot in place of the cancellation that it caused."""
        if robot.is_given_up and isinstance(error, CallCancelledError):
            why = f"its outcome is unknown: the robot {self._error(robot).message}"
            return UnavailableError(why, robot=robot.name, resource=error.resource)
        return error

    def handle(
        self, context: ExecutionContext, robot: Participant, error: EALError, losses: int
    ) -> Generator[Future[Any], None, FailureAction | Literal["repeat"] | None]:
        """Wait for a robot whose step failed because it was lost, as its role wants it; return what follows.

        That is None if it was no loss, if the robot is back at once, or if `on_lost` is not set. `losses` is the number
        of its losses before the attempt.
        """
        policy = context.on_lost
        if policy is None or not (yield from self._is_loss(context, robot, error, losses)):
            return None
        wait_s = 0.0
        if robot.is_lost:
            wait_s = max(0.0, self._limit_s(robot, context.lost_after_s) - self._loop.clock.now())
        if isinstance(policy, WaitPolicy):
            wait_s += policy.wait_s
        if robot.is_lost:
            yield from self._wait_for_change(context, robot, wait_s)
        if robot.is_lost:
            return _ACTIONS[policy.then if isinstance(policy, WaitPolicy) else policy]
        if not isinstance(policy, WaitPolicy):
            return None
        robot.is_rejoining = policy.rejoin
        return "skip" if policy.rejoin else "repeat"

    def _is_loss(
        self, context: ExecutionContext, robot: Participant, error: EALError, losses: int
    ) -> Generator[Future[Any], None, bool]:
        """Return whether a step failed because its robot was lost, or is about to be: its server is being stopped."""
        is_leaving = SERVICE_ENDS in error.message
        if is_leaving and len(robot.losses) == losses and not robot.is_lost:
            yield from self._wait_for_change(context, robot, self._loop.clock.of_real(_LEAVE_S))
        is_cause = is_leaving or isinstance(error, UnavailableError | CallCancelledError)
        return is_cause and (len(robot.losses) > losses or robot.is_lost)

    def _wait_for_change(
        self, context: ExecutionContext, robot: Participant, wait_s: float
    ) -> Generator[Future[Any], None, None]:
        """Wait until a robot is lost or back, for a limited time, or until its run, its task or itself is stopped."""
        future: Future[None] = Future(self._loop.clock)
        self._waiting[future] = robot
        timer = self._loop.call_at(self._loop.clock.now() + wait_s, future.set)
        try:
            yield from self._wait(context, future)
        finally:
            timer.cancel()
            del self._waiting[future]

    def leaves_out(self, context: ExecutionContext) -> bool:
        """Return whether a robot was lost, and leaves out all that it would do before its next meeting."""
        return context.robot is not None and context.robot.is_rejoining and not context.is_finally

    def skips(self, context: ExecutionContext, step: Step) -> bool:
        """Return whether a robot that was lost leaves out a step, since it rejoins at its next meeting."""
        robot, frame = context.robot, context.frame
        if robot is None or not self.leaves_out(context):
            return False
        if step.meeting(frame) is not None:
            robot.is_rejoining = False
        return not find_meetings(frame, (step,))
