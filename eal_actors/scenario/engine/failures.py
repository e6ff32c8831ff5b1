"""The consequences of a failed step: repetition, the policy for lost robots, outcomes, spares, and the end of the run.

A step that succeeds at once needs nothing of this module.
"""

from __future__ import annotations

from collections.abc import Generator
from functools import partial
from typing import Any

from eal_actors.actors.future import Future
from eal_actors.actors.stop_latch import holds_robot
from eal_actors.kernel.errors import CallCancelledError, CallError, EALError, PreemptedError, StoppedError
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.frames import Participant
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.scenario import FallibleModel
from eal_actors.scenario.language.values import OnFailure, RetryPolicy, final_action
from eal_actors.scenario.report.events import StepRetried
from eal_actors.scenario.report.summary import ErrorReport, StepOutcome


class StepFailure:
    """The failed attempts of one step by one robot, and what follows; `error` is why the last attempt failed."""

    def __init__(self, step: FallibleModel, path: str, action: StepAction, error: EALError) -> None:
        self.error = error
        self._run = action.run
        self._context = context = action.context
        self._path = path
        self._action = action
        own, attempt = step.on_failure, context.attempt
        is_inside = attempt is not None and (attempt.repeats is step or own is None)
        self._attempt = attempt if is_inside and not context.is_finally else None
        self._policy: OnFailure = "drop" if context.is_finally else context.effective_policy(own)
        self._policy = "abort" if self._attempt is not None else self._policy
        self._retries = self._policy.retry if isinstance(self._policy, RetryPolicy) else 0

    @property
    def _robot(self) -> Participant | None:
        return self._action.robot

    def repeats(self, error: EALError, attempts: int, losses: int) -> Generator[Future[Any], None, bool]:
        """Return whether another attempt follows the one that failed, after the pause before it.

        `losses` is the number of the robot's losses before that attempt.
        """
        run = self._run
        if (after_loss := (yield from self._after_loss(error, losses))) is None:
            return True
        self.error = after_loss
        yield from self._ask_who_halted()
        if self._is_emergency():
            run.stop_for_emergency(f"emergency stop: {self.error}", is_finally=self._context.is_finally)
        if self._is_over() or not self._action.is_begun or attempts > self._retries:
            return False
        run.emit(partial(self._retried, attempts, ErrorReport.of(self.error)))
        if isinstance(self._policy, RetryPolicy) and self._policy.back_off_s:
            try:
                yield from run.sleep(self._context, self._policy.pause_s(attempts))
            except CallCancelledError:
                return False
        return True

    def _after_loss(self, error: EALError, losses: int) -> Generator[Future[Any], None, EALError | None]:
        """Apply the policy for lost robots if the robot was lost; return None to repeat the attempt."""
        robot, run = self._robot, self._run
        if robot is None or run.losses is None:
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

    def _ask_who_halted(self) -> Coroutine:
        """Ask a robot that was halted whether an emergency stop did: another controller's may not be known here yet."""
        robot = self._robot
        if robot is None or not isinstance(self.error, PreemptedError) or self._is_emergency() or self._is_over():
            return
        yield (ping := robot.handle.ping())
        stopped = ping.get().stopped if ping.exception() is None else None
        if stopped is not None:
            end, held = self.error.message, holds_robot(stopped)  # the robot's server has said so, unless it is older
            self.error = StoppedError(end if held in end else f"{end}: {held}").at(robot.name)

    def _retried(self, attempt: int, error: ErrorReport, time_s: float) -> StepRetried:
        name = self._robot.name if self._robot is not None else None
        return StepRetried(time_s, name, self._path, self._action.label, attempt, error)

    def _is_over(self) -> bool:
        """Return whether no attempt may follow: the run, the task or the robot is stopped."""
        return (
            self._run.is_stopping
            or self._context.task.is_stopped
            or self._context.robot is not self._robot
            or (self._robot is not None and self._robot.outcome is not None and not self._context.is_finally)
        )

    def _is_emergency(self) -> bool:
        """Return whether the step failed because of the emergency stop of its robot."""
        is_held = self._robot is not None and self._robot.handle.stopped_because is not None
        return isinstance(self.error, StoppedError) or (is_held and isinstance(self.error, CallError))

    def outcome(self, attempts: int) -> StepOutcome:
        """Return the outcome of the step after so many attempts."""
        if self._is_emergency():
            return "aborted"
        was_cut = isinstance(self.error, CallCancelledError) or attempts <= self._retries
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

    def apply(self, outcome: StepOutcome) -> Coroutine:
        """Apply the outcome to the robot and to the run."""
        robot, run = self._robot, self._run
        if outcome == "failed":
            yield from self._end_failed()
        elif outcome == "dropped" and not self._context.is_finally:
            leaving = [one for one in (self._action.late if robot is None else [robot]) if one.outcome is None]
            for one in leaving:
                run.drop(one, self.error)
            yield from run.halt(leaving)
        elif outcome == "replaced" and robot is not None and robot.outcome is None:
            slot, spare = self._context.slot, self._spare()
            if slot is not None and spare is not None and not self._context.is_finally:
                run.replace(slot, spare, self.error)
                yield from run.halt([robot])

    def _end_failed(self) -> Coroutine:
        """End the attempt of the block around the step and halt its robots, or end the run."""
        if (attempt := self._attempt) is not None:
            robots = [robot for robot in dict.fromkeys(attempt.robots()) if robot.outcome is None]
            touched = attempt.touched if attempt.slot is not None and not attempt.touches_all else None
            attempt.fail(self.error)
            yield from self._run.halt(robots, touched)
            return
        robot, is_finally = self._robot, self._context.is_finally
        if robot is None:
            self._run.failures.append(self.error)
        elif not is_finally or robot.outcome == "done":
            robot.end("failed", self.error)
        else:  # in the `finally` of a part it continues, and has failed at the end of the run
            robot.error = robot.error or self.error
        if not is_finally:
            self._run.stop()
