"""The event loop of a run: one thread for any number of coroutines.

A coroutine is a generator that yields the futures it waits for. The loop takes no lock, so that a signal handler can
post to it whatever it interrupts. It keeps its own timers, because the deadlines of calls must expire even if a robot's
thread is stuck.
"""

from __future__ import annotations

import itertools
import queue
from collections.abc import Callable, Generator
from typing import Any, TypeAlias

from eal_actors.actors.future import Future
from eal_actors.kernel.clock import ROUNDING_S, Clock, Timer, TimerHeap, new_waiter

Coroutine: TypeAlias = Generator[Future[Any], None, None]
"""Yields futures; it continues when a future is done, whatever its outcome."""


class EventLoop:
    """Runs actions and coroutines in the thread that calls `run`; `on_error` is called with what an action raises."""

    def __init__(self, clock: Clock, on_error: Callable[[Exception], None]) -> None:
        self.clock = clock
        self._on_error = on_error
        self._actions: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._wakeup = new_waiter()
        self._timers: TimerHeap[Timer] = TimerHeap()
        self._order = itertools.count()

    def post(self, action: Callable[[], None]) -> None:
        """Run an action soon. Thread: any, signal handlers too; never blocks."""
        self._actions.put(action)
        self.clock.wake(self._wakeup)

    def call_at(self, time_s: float, action: Callable[[], None]) -> Timer:
        """Run an action when the clock shows `time_s`; as for Timekeeper. Thread: the loop's own."""
        timer = Timer(time_s, next(self._order), action)
        self._timers.add(timer)
        return timer

    def sleep(self, duration_s: float) -> Future[None]:
        """Return a future that is done after a duration. Thread: the loop's own."""
        future: Future[None] = Future(self.clock)
        timer = self.call_at(self.clock.now() + duration_s, future.set)
        future.add_done_callback(lambda _: timer.cancel())  # or a sleep that is cut short would be kept until its time
        return future

    def checkpoint(self) -> Future[None]:
        """Return a future that is done after everything else that is due has run. Thread: the loop's own."""
        future: Future[None] = Future(self.clock)
        self.post(future.set)
        return future

    def spawn(self, coroutine: Coroutine, on_end: Callable[[BaseException | None], None]) -> None:
        """Run a coroutine to its first future, then on; call back with its error or None. Thread: the loop's own."""

        def go_on(_: object = None) -> None:
            try:
                for future in coroutine:
                    if not future.done():
                        if future.clock is self.clock:
                            future.timekeeper = self  # its deadline expires here even if its robot is stuck
                        future.add_done_callback(lambda _: self.post(go_on))
                        return
            except BaseException as error:  # noqa: BLE001  # the waiting task must learn of the end
                on_end(error)
            else:
                on_end(None)

        go_on()

    def run(self, coroutine: Coroutine) -> None:
        """Run until a coroutine has ended; raise its error. Thread: blocks; becomes the loop's own."""
        ended: list[BaseException | None] = []
        self.spawn(coroutine, ended.append)
        while not ended:
            self._wait()
            self._run_due()
            for _ in range(self._actions.qsize()):
                self._do(self._actions.get_nowait())
        if ended[0] is not None:
            raise ended[0]

    def _wait(self) -> None:
        while self._actions.empty():
            timer = self._timers.first()
            timeout_s = timer.time_s - self.clock.now() if timer is not None else None
            if timeout_s is not None and timeout_s <= ROUNDING_S:
                return
            self.clock.wait(self._wakeup, timeout_s)

    def _run_due(self) -> None:
        now_s = self.clock.now() + ROUNDING_S
        while (timer := self._timers.first()) is not None and timer.time_s <= now_s:
            action = self._timers.pop().action
            if action is not None:
                self._do(action)

    def _do(self, action: Callable[[], object]) -> None:
        try:
            action()
        except Exception as error:  # noqa: BLE001  # the coroutines must go on, to halt the robots
            self._on_error(error)
