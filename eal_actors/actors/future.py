"""Futures with done-callbacks, cancellation and a deadline of their own."""

from __future__ import annotations

import asyncio
import concurrent.futures
import sys
import threading
from collections.abc import Callable, Generator
from functools import partial
from types import TracebackType
from typing import Any, Protocol, TypeAlias, TypeVar

import pykka

from eal_actors.kernel.clock import REAL_TIME, Clock, new_waiter, wait_in_scope
from eal_actors.kernel.errors import CallCancelledError, DeadlineError, EALError, WaitTimeoutError
from eal_actors.kernel.log import get_logger

T = TypeVar("T")
M = TypeVar("M")
OptExcInfo: TypeAlias = tuple[type[BaseException] | None, BaseException | None, TracebackType | None]

Later: TypeAlias = Callable[[Callable[[], None]], None]
"""Has an action run soon, by a thread that may run anybody's code."""

Relay: TypeAlias = "Callable[[Future[Any], Later | None], None]"
"""Passes a future's outcome on. Thread: whichever finishes the future: it is quick, runs nobody else's code, and hands
what does to the second argument, where there is one."""


class Alarm(Protocol):
    """A timer that can be called off."""

    def cancel(self) -> None:
        """Call it off; harmless when it has rung."""
        ...


class Timekeeper(Protocol):
    """Something that rings futures' deadlines: an actor's inbox."""

    def call_at(self, time_s: float, action: Callable[[], None]) -> Alarm:
        """Run the action in the keeper's thread when its clock shows `time_s`."""
        ...


class Future(pykka.Future[T]):
    """The answer to a call, now or later.

    The first outcome stands: a result that comes after the deadline or a cancellation is dropped. A future with a
    deadline never leaves anybody waiting beyond it: whoever waits in `get` watches the time himself, and for
    callbacks, `await` and `gather` the timekeeper does.

    Args:
        clock: the clock of its deadline and of `get`'s time-out.
        deadline_s: the time of that clock at which the call fails; None for none.
        timekeeper: who rings the deadline when nobody waits in `get`.
    """

    def __init__(
        self, clock: Clock = REAL_TIME, deadline_s: float | None = None, timekeeper: Timekeeper | None = None
    ) -> None:
        self.clock = clock
        self.deadline_s = deadline_s
        self.timekeeper = timekeeper
        self._lock = threading.Lock()
        self._done = False
        self._value: Any = None
        self._error: BaseException | None = None
        self._traceback: TracebackType | None = None
        self._waiters: list[threading.Lock] | None = None
        self._callbacks: list[Callable[[Future[T]], None]] | None = None
        self._relays: list[Relay] | None = None
        self._alarm: Alarm | None = None

    _get_hook: Callable[[float | None], T] | None = None
    # Pykka sets it in __init__, which would cost every call: ours waits until set_get_hook.

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.describe()}: {'done' if self._done else 'pending'}>"

    def describe(self) -> str:
        """Return what the future stands for, for messages."""
        return "future"

    # Outcome.

    def done(self) -> bool:
        """Return whether the outcome is there. Thread: any."""
        return self._done

    def cancelled(self) -> bool:
        """Return whether it was cancelled. Thread: any."""
        return isinstance(self._error, CallCancelledError)

    def set(self, value: Any = None) -> None:
        """Set the result, unless there is an outcome already. Thread: any."""
        self._finish(value, None)

    def set_exception(self, exc_info: BaseException | OptExcInfo | None = None) -> None:
        """Set the failure: an exception, Pykka's triple, or the exception being handled. Thread: any."""
        error = exc_info if isinstance(exc_info, BaseException) else (exc_info or sys.exc_info())[1]
        if error is None:
            raise TypeError("set_exception needs an exception where none is being handled")
        self._finish(None, error)

    def settle(self, value: Any, error: BaseException | None, later: Later) -> None:
        """Set an outcome from a thread that must not be held up, such as one of a network engine.

        Whoever waits in `get` is woken and relays run at once; callbacks are handed to `later`. Thread: any.
        """
        self._finish(value, error, later)

    def _finish(self, value: Any, error: BaseException | None, later: Later | None = None) -> bool:
        with self._lock:
            if self._done:
                return False
            self._value = value
            if error is not None:
                self._error = error
                self._traceback = error.__traceback__
            self._done = True
            waiters, callbacks, relays, alarm = self._waiters, self._callbacks, self._relays, self._alarm
            self._waiters = self._callbacks = self._relays = self._alarm = None
        if waiters:
            for waiter in waiters:
                self.clock.wake(waiter)
        if alarm is not None:
            alarm.cancel()
        if relays:
            for relay in relays:
                relay(self, later)
        if callbacks:
            for callback in callbacks:
                if later is None:
                    self._run(callback)
                else:
                    later(partial(self._run, callback))
        return True

    def _run(self, callback: Callable[[Future[T]], None]) -> None:
        try:
            callback(self)
        except (Exception, SystemExit, GeneratorExit):  # noqa: BLE001  # another's callback must not break the thread that finishes the call
            get_logger().exception("a future's done-callback raised", future=self.describe())

    def cancel(self) -> bool:
        """Give up the call: what it started is stopped. Returns False if there was an outcome already. Thread: any."""
        if self._finish(None, self._cancelled()):
            self._given_up()
            return True
        return False

    def expire(self) -> None:
        """Fail with DeadlineError, unless there is an outcome: the deadline has passed. Thread: any."""
        if self._finish(None, self._expired()):
            self._given_up()

    def _cancelled(self) -> EALError:
        return CallCancelledError(f"{self.describe()} was cancelled")

    def _expired(self) -> EALError:
        return DeadlineError(f"{self.describe()} had no answer before its deadline")

    def _given_up(self) -> None:
        """Tell the other side that nobody waits any more."""

    # Waiting.

    def get(self, *, timeout: float | None = None) -> T:
        """Return the result, waiting for it at most until the deadline.

        Args:
            timeout: seconds of the clock to wait at most; the call itself goes on after it.

        Raises:
            DeadlineError: the call's deadline passed.
            WaitTimeoutError: the time-out passed.
            CallCancelledError: the call was cancelled; or the caller's task was, which cancels the call.
            Exception: whatever the call failed with.

        Thread: blocks the caller; never call it in an actor on a future of its parent or peer.
        """
        if self._get_hook is not None:
            return super().get(timeout=timeout)
        if not self._done:
            self._wait(timeout)
        if self._error is not None:
            raise self._error.with_traceback(self._traceback)
        return self._value  # type: ignore[no-any-return]  # set() takes what the maker of the future promised

    def exception(self, *, timeout: float | None = None) -> BaseException | None:
        """Return the failure, or None for success, waiting like `get`. Thread: blocks the caller."""
        if not self._done:
            self._wait(timeout)
        return self._error

    def _wait(self, timeout: float | None) -> None:
        waiter = new_waiter()
        with self._lock:
            if self._done:
                return
            if self._waiters is None:
                self._waiters = []
            self._waiters.append(waiter)
        clock = self.clock
        limit = None if timeout is None else clock.now() + timeout
        if self.deadline_s is not None and (limit is None or self.deadline_s <= limit):
            limit = self.deadline_s
        while not self._done:
            remaining = None if limit is None else limit - clock.now()
            if remaining is not None and remaining <= 0:
                break
            try:
                wait_in_scope(clock, waiter, remaining)
            except CallCancelledError:
                self._forget(waiter)
                self.cancel()
                raise
        if self._done:
            return
        self._forget(waiter)
        if limit == self.deadline_s:
            self.expire()
        else:
            raise WaitTimeoutError(f"{self.describe()} had no answer within {timeout:g} s; it goes on")

    def _forget(self, waiter: threading.Lock) -> None:
        with self._lock:
            if self._waiters is not None:
                self._waiters.remove(waiter)

    # Callbacks.

    def add_done_callback(self, callback: Callable[[Future[T]], None]) -> None:
        """Call back with this future when it is done, at once if it is. Errors of the callback are logged.

        Thread: the callback runs in the thread that finishes the future, so it must not block.
        """
        with self._lock:
            if not self._done:
                if self._callbacks is None:
                    self._callbacks = []
                self._callbacks.append(callback)
            is_pending = not self._done
        if is_pending:
            self.arm()
        else:
            self._run(callback)

    def link(self, relay: Relay) -> None:
        """Have the outcome passed on as soon as it is there, at once if it is; see Relay.

        Unlike a callback, a relay sets no alarm: who links watches the deadline, or leaves that to who links to him.
        Thread: any.
        """
        with self._lock:
            if not self._done:
                if self._relays is None:
                    self._relays = []
                self._relays.append(relay)
                return
        relay(self, None)

    def arm(self) -> None:
        """Have the timekeeper ring the deadline. Thread: any."""
        if self._alarm is None and not self._done and self.timekeeper is not None and self.deadline_s is not None:
            alarm = self.timekeeper.call_at(self.deadline_s, self.expire)
            with self._lock:
                if not self._done:
                    self._alarm = alarm
                    return
            alarm.cancel()

    def to_concurrent(self) -> concurrent.futures.Future[T]:
        """Return a standard library future with the same outcome; cancelling it cancels this one. Thread: any."""
        mirror: concurrent.futures.Future[T] = concurrent.futures.Future()

        def copy(_: Future[T]) -> None:
            if not mirror.set_running_or_notify_cancel():
                return
            if self._error is not None:
                mirror.set_exception(self._error)
            else:
                mirror.set_result(self._value)

        mirror.add_done_callback(lambda m: self.cancel() if m.cancelled() else None)
        self.add_done_callback(copy)
        return mirror

    def __await__(self) -> Generator[Any, None, T]:
        """Wait for the result in an asyncio program; cancelling the task cancels the call."""
        return asyncio.wrap_future(self.to_concurrent()).__await__()

    def map(self, func: Callable[[T], M]) -> Future[M]:
        """Return a future of what the function makes of the result.

        Thread: the function runs in the thread that finishes this future, so it must not block.
        """
        mapped: _Mapped[M] = _Mapped(self)

        def apply() -> None:
            if self._error is not None:
                mapped.set_exception(self._error)
                return
            try:
                mapped.set(func(self._value))
            except Exception as error:  # noqa: BLE001  # it is the outcome
                mapped.set_exception(error)

        self.link(lambda _, later: apply() if later is None else later(apply))
        return mapped

    def set_get_hook(self, func: Callable[[float | None], T]) -> None:
        """See Pykka, whose ActorRef.stop() needs it. Hooked futures answer `get` alone; make others with `map`."""
        pykka.Future.__init__(self)
        super().set_get_hook(func)


class _Mapped(Future[T]):
    """What becomes of another future: given up together with it."""

    def __init__(self, source: Future[Any]) -> None:
        super().__init__(source.clock, source.deadline_s, source.timekeeper)
        self._source = source

    def describe(self) -> str:
        return self._source.describe()

    def expire(self) -> None:
        self._source.expire()

    def _given_up(self) -> None:
        self._source.cancel()
