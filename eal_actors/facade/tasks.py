"""Task groups: structured concurrency for controllers that are written as blocking Python.

A task is a function in a thread of its own that lives by the fleet's clock, lock step included. A group ends when its
last task has ended, so no thread and no motion outlives it:

- The first failure, an error of the `with` block (Ctrl-C too) and the deadline cancel the whole group.
- To cancel is to interrupt the waits of all tasks with CallCancelledError, which cancels the calls that they wait for,
  and to halt the robots that were given to tasks. They are halted again when all tasks have ended, for a task may send
  a command before it notices.
- The group raises the first error itself, not an ExceptionGroup as trio does: a robot that fails makes others fail, and
  `except UnavailableError` should mean what it means for one robot. Later errors are notes of the first.

Threads are used, not coroutines, since the calls of a controller block in `Future.get`. A function that waits for
something else, such as a socket, cannot be interrupted: its group waits for it.
"""

from __future__ import annotations

import contextvars
import inspect
import threading
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from types import TracebackType
from typing import Any, ParamSpec, Self, TypeVar

from typing_extensions import override

from eal_actors.actors.combine import gather
from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.kernel.clock import CancelScope, Clock, current_scope, in_scope, new_waiter, wait_in_scope
from eal_actors.kernel.errors import CallCancelledError, DeadlineError, PreemptedError

P = ParamSpec("P")
T = TypeVar("T")


class _TaskFuture(Future[T]):
    """One task of a group, and the future of its result. Cancelling it interrupts the task and halts its robots."""

    def __init__(self, clock: Clock, name: str, robots: list[RobotHandle], parent: CancelScope) -> None:
        super().__init__(clock)
        self.name = name
        self.robots = robots
        self.scope = CancelScope(parent)
        self.thread: threading.Thread
        self.is_running = True

    @override
    def describe(self) -> str:
        return f"task {self.name}"

    @override
    def _given_up(self) -> None:
        self.scope.cancel()
        for robot in self.robots:
            robot.halt()


class TaskGroup:
    """Tasks that run at the same time and end together; made by `Fleet.tasks`.

        with fleet.tasks() as tasks:
            squares = [tasks.start(drive_square, robot) for robot in fleet.values()]
            tasks.start(watch_bumpers, fleet)
        print([square.get() for square in squares])

    Leaving the block waits for the tasks, for `timeout_s` seconds of the clock or without limit.
    """

    def __init__(self, clock: Clock, timeout_s: float | None = None) -> None:
        self._clock = clock
        self._timeout_s = timeout_s
        self._lock = threading.Lock()
        self._tasks: list[_TaskFuture[Any]] = []
        self._errors: list[BaseException] = []
        self._ended = new_waiter()
        self._outer: CancelScope | None = None
        self._scope: CancelScope | None = None
        self._block = ExitStack()

    def start(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Start `function(*args, **kwargs)` in a thread of its own; return the future of its result.

        Cancelling the future cancels the task. The robots among the arguments are halted when the task or the group is
        cancelled. Raises RuntimeError if the group's `with` block has not begun or is over. Thread: any; does not
        block.
        """
        if self._scope is None:
            raise RuntimeError("start tasks inside the `with` block of their group")
        robots = [value for value in (*args, *kwargs.values()) if isinstance(value, RobotHandle)]
        name = " ".join([getattr(function, "__name__", "task"), *(robot.name for robot in robots)])
        task: _TaskFuture[T] = _TaskFuture(self._clock, name, robots, self._scope)
        run = partial(contextvars.copy_context().run, self._run, task, partial(function, *args, **kwargs))
        task.thread = threading.Thread(target=run, name=name, daemon=True)  # daemon: a second Ctrl-C ends the program
        with self._lock:
            self._tasks.append(task)
        self._clock.start(task.thread)
        return task

    def cancel(self) -> None:
        """Interrupt every task and the `with` block, and halt the robots of the tasks. Thread: any; does not block."""
        if self._scope is not None and not self._scope.is_cancelled:
            self._scope.cancel()
            self._halt()

    def _halt(self) -> Future[list[list[int]]]:
        with self._lock:
            robots = dict.fromkeys(robot for task in self._tasks for robot in task.robots)
        return gather([robot.halt() for robot in robots])

    # A task. Thread: the task's own.

    def _run(self, task: _TaskFuture[T], function: Callable[[], T]) -> None:
        try:
            with in_scope(task.scope):
                result = function()
            if inspect.iscoroutine(result):  # nothing of it has run, and nothing would
                result.close()
                raise TypeError(f"{task.name} is an async function; a task is a function that blocks")
        except BaseException as error:  # noqa: BLE001  # it is raised where the group ends
            self._fail(task, error)
        else:
            task.set(result)
        finally:
            task.scope.close()
            task.is_running = False
            self._clock.wake(self._ended)

    def _fail(self, task: _TaskFuture[Any], error: BaseException) -> None:
        is_result_of_cancel = task.scope.is_cancelled and isinstance(error, CallCancelledError | PreemptedError)
        if not is_result_of_cancel:
            error.add_note(f"raised by task {task.name}")
            with self._lock:
                self._errors.append(error)
            self.cancel()
        task.set_exception(error)

    # The block. Thread: the one that runs it.

    def __enter__(self) -> Self:
        self._outer = current_scope()
        self._scope = CancelScope(self._outer)
        self._block.callback(self._scope.close)
        self._block.enter_context(in_scope(self._scope))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> bool:
        failure = error
        with self._block:
            if failure is None:
                try:
                    self._wait_for_tasks()
                except BaseException as caught:  # noqa: BLE001  # it is raised below, when all tasks have ended
                    failure = caught
            if self._is_own_cancel(failure):
                failure = None
            elif failure is not None:
                self.cancel()
            self._end_tasks()
        self._scope = None
        if failure is None and self._errors:
            failure = self._errors[0]
        for other in self._errors:
            if failure is not None and other is not failure:
                failure.add_note(f"{other.__notes__[0]} too: {type(other).__name__}: {other}")
        if failure is not None and failure is not error:
            raise failure
        return failure is None

    def _is_own_cancel(self, error: BaseException | None) -> bool:
        """Return whether an error only says that this group, and not one around it, was cancelled."""
        is_cancelled = self._scope is not None and self._scope.is_cancelled
        is_outer_cancelled = self._outer is not None and self._outer.is_cancelled
        return isinstance(error, CallCancelledError) and is_cancelled and not is_outer_cancelled

    def _running(self) -> list[_TaskFuture[Any]]:
        """Return the tasks whose threads were started (Ctrl-C can strike before that) and have not ended."""
        return [task for task in self._tasks if task.is_running and task.thread.ident is not None]

    def _wait_for_tasks(self) -> None:
        end_s = None if self._timeout_s is None else self._clock.now() + self._timeout_s
        while running := self._running():
            left_s = None if end_s is None else end_s - self._clock.now()
            if left_s is not None and left_s <= 0:
                names = ", ".join(task.name for task in running)
                raise DeadlineError(f"tasks did not end within {self._timeout_s:g} s: {names}")
            wait_in_scope(self._clock, self._ended, left_s)

    def _end_tasks(self) -> None:
        """Wait until every task has ended, and for the halts if the group was cancelled.

        The threads are joined while this thread has the turn of a lock-step clock: a task that has ended needs none,
        and time must not go on meanwhile.
        """
        with in_scope(None):
            while self._running():
                self._clock.wait(self._ended, None)
            for task in self._tasks:
                if task.thread.ident is not None:
                    task.thread.join()
            if self._scope is not None and self._scope.is_cancelled:
                self._halt().exception()  # a robot that is out of reach cannot answer; the group's error says more
