"""Lines of steps that go on beside each other, and when they are over."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from eal_actors.actors.future import Future
from eal_actors.kernel.errors import CallCancelledError
from eal_actors.scenario.engine.cast import Context, RobotRun, Task
from eal_actors.scenario.engine.loop import Branch
from eal_actors.scenario.engine.stage import Stage


class Group:
    """Lines that begin together and that another waits for.

    Args:
        stage: the run.
        context: where the step stands that begins them.
        until: `all`, `first` or a signal.
        timeout_s: how long they may take; None for as long as they like.

    Attributes:
        late: who was at work when time was up; None if they were over in time.
    """

    def __init__(self, stage: Stage, context: Context, until: str, timeout_s: float | None = None) -> None:
        self.late: list[RobotRun] | None = None
        self._timeout_s = timeout_s
        self._stage = stage
        self._context = context
        self._until = until
        self._over: Future[None] = Future(stage.clock)
        self._all_ended: Future[None] = Future(stage.clock)
        self._left: dict[Task, None] = {}

    def perform(self, lines: Sequence[tuple[Task, Branch]]) -> Branch:
        """Go through all lines, until they are over; who is not through by then is halted."""
        if not lines:
            return
        stage, parent = self._stage, self._context.task
        for task, _ in lines:
            self._left[task] = None
            parent.children[task] = None
        for task, _ in lines:
            stage.meetings.enter(task)
        if self._until not in ("all", "first"):
            signal = stage.signals.wait(self._context.unit, self._until)
            signal.add_done_callback(lambda _: self._over.set())
        for task, branch in lines:
            stage.loop.spawn(branch, partial(self._ended, task))
        if self._timeout_s is None:
            yield self._over
        else:
            yield from self._wait_within(self._timeout_s)
        if self._left:
            yield from self._stop_rest()

    def _wait_within(self, timeout_s: float) -> Branch:
        """Wait until they are over, or time is up."""
        try:
            is_over = yield from self._stage.wait_within(self._context, self._over, timeout_s)
        except CallCancelledError:  # they are being stopped as well
            yield self._over
            return
        if not is_over:
            robots = dict.fromkeys(robot for task in self._left for robot in task.robots())
            self.late = [robot for robot in robots if robot.outcome is None]

    def _ended(self, task: Task, error: BaseException | None) -> None:
        stage = self._stage
        self._left.pop(task, None)
        self._context.task.children.pop(task, None)
        stage.meetings.leave(task)
        if error is not None:
            stage.fail(error)
        if not self._left:
            self._over.set()
            self._all_ended.set()
        elif self._until == "first" and self._came_through(task):
            self._over.set()

    def _came_through(self, task: Task) -> bool:
        """Return whether a line has gone through all of its steps, and was not cut short."""
        if task.is_stopped or self._stage.is_stopping:
            return False
        return task.seat is None or task.seat.robot.outcome is None

    def _stop_rest(self) -> Branch:
        tasks = list(self._left)
        seat = self._context.seat
        robots = dict.fromkeys([seat.robot] if seat else [robot for task in tasks for robot in task.robots()])
        for task in tasks:
            task.stop()
        if self._left:
            yield self._all_ended
        touched: dict[str, None] | None = None
        if seat is not None and not any(task.touches_all for task in tasks):  # the robot's other branches go on
            touched = {name: None for task in tasks for name in task.touched}
        yield from self._stage.halt([robot for robot in robots if robot.outcome is None], touched)
