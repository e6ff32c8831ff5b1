"""Futures with done-callbacks, cancellation and a deadline of their own.

Pykka's futures have no done-callbacks and wait forever unless told otherwise. These never leave anybody waiting beyond
the deadline: a thread that waits in `get` watches the time itself, and for callbacks, `await` and `gather` a timer of
the timekeeper does. No timer is set while threads only wait in `get`, because setting one would cost every call.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import math
import sys
import threading
from collections.abc import Callable, Generator
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Any, NoReturn, Protocol, TypeAlias, TypeVar

import pykka
from typing_extensions import override

from eal_actors.kernel.clock import REAL_TIME, Clock, Timer, wait_in_scope
from eal_actors.kernel.errors import CallCancelledError, DeadlineError, EALError, WaitTimeoutError
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.unwinding import AbandonedThread

T = TypeVar("T")
M = TypeVar("M")
OptExcInfo: TypeAlias = tuple[type[BaseException] | None, BaseException | None, TracebackType | None]

CallSoon: TypeAlias = Callable[[Callable[[], None]], None]
"""Schedules an action in a thread that may run user code."""

Relay: TypeAlias = "Callable[[Future[Any], CallSoon | None], None]"
"""Passes a future's outcome on. Thread: the one that finishes the future. A relay is quick and runs no user code: it
hands that to the second argument if there is one."""


class Timekeeper(Protocol):
    """Runs the timers of futures' deadlines: an actor's inbox or a scenario's loop."""

    def call_at(self, time_s: float, action: Callable[[], None]) -> Timer:
        """Run the action in the keeper's thread when its clock shows `time_s`."""


class Future(pykka.Future[T]):
    """The answer to a call, now or later.

    The first outcome counts: a result that arrives after the deadline or a cancellation is dropped.

    Args:
        clock: the clock of the deadline and of `get`'s time-out.
        deadline_s: the time of that clock at which the call fails; None for none.
        timekeeper: runs the deadline's timer while nobody waits in `get`.
    """

    def __init__(
        self, clock: Clock = REAL_TIME, deadline_s: float | None = None, timekeeper: Timekeeper | None = None
    ) -> None:
        self.clock = clock
        self.deadline_s = deadline_s
        self.timekeeper = timekeeper
        self._lock = threading.Lock()

    # Set on the class, not by each call: most calls keep them.
    _done = False
    _value: Any = None
    _error: BaseException | None = None
    _traceback: TracebackType | None = None
    _waiters: list[threading.Lock] | None = None
    _callbacks: list[Callable[[Future[T]], None]] | None = None
    _relays: list[Relay] | None = None
    _timer: Timer | None = None
    _get_hook: Callable[[float | None], T] | None = None  # Pykka sets it in __init__; ours waits until set_get_hook

    def __repr__(self) -> str:
        ended = "cancelled" if self.cancelled() else "failed" if self._error is not None else "done"
        state = ended if self._done else "pending"
        return f"<{type(self).__name__} {self.describe()}: {state}>"

    def describe(self) -> str:
        """Return a name of the future for messages."""
        return "future"

    # Outcome.

    @property
    def outcome(self) -> tuple[Any, BaseException | None]:
        """The result and the failure of a future that is done; one is None. Thread: any."""
        return self._value, self._error

    def done(self) -> bool:
        """Return whether there is an outcome. Thread: any."""
        return self._done

    def cancelled(self) -> bool:
        """Return whether it was cancelled. Thread: any."""
        return isinstance(self._error, CallCancelledError)

    @override
    def set(self, value: Any = None) -> None:
        """Set the result unless there is an outcome already. Thread: any."""
        self.settle(value, None)

    @override
    def set_exception(self, exc_info: BaseException | OptExcInfo | None = None) -> None:
        """Set the failure: an exception, Pykka's triple, or the exception being handled. Thread: any."""
        error = exc_info if isinstance(exc_info, BaseException) else (exc_info or sys.exc_info())[1]
        if error is None:
            raise TypeError("set_exception needs an exception where none is being handled")
        self.settle(None, error)

    def fail(self, error: BaseException) -> None:
        """Set the failure. Thread: any."""
        self.settle(None, error)

    def settle(self, value: Any, error: BaseException | None, call_soon: CallSoon | None = None) -> bool:
        """Set the outcome; return False if there is one already.

        Args:
            value: the result.
            error: the failure; None for a result.
            call_soon: runs the callbacks, if this thread must not block; waiting threads and relays do not wait for it.

        Thread: any.
        """
        with self._lock:
            if self._done:
                return False
            self._value = value
            if error is not None:
                self._error = error
                self._traceback = error.__traceback__
            self._done = True
        if self._waiters is not None:  # nothing is added to the four of them from now on
            for waiter in self._waiters:
                self.clock.wake(waiter)
        if self._timer is not None:
            self._timer.cancel()
        relays, self._relays = self._relays, None
        if relays is not None:
            for relay in relays:
                relay(self, call_soon)
        if self._callbacks is not None:
            self._run_callbacks(call_soon)
        return True

    def _run_callbacks(self, call_soon: CallSoon | None) -> None:
        callbacks, self._callbacks = self._callbacks or [], None
        for callback in callbacks:
            if call_soon is None:
                self._run_callback(callback)
            else:
                call_soon(partial(self._run_callback, callback))

    def _run_callback(self, callback: Callable[[Future[T]], None]) -> None:
        try:
            callback(self)
        except (KeyboardInterrupt, AbandonedThread):  # they are meant for this thread
            raise
        except BaseException:  # noqa: BLE001  # user code must not break the thread that finishes the call
            get_logger().exception("a future's done-callback raised", future=self.describe())

    def cancel(self) -> bool:
        """Cancel the call and stop what it started; return False if there was an outcome already. Thread: any."""
        if self.settle(None, self._cancellation_error()):
            self._given_up()
            return True
        return False

    def expire(self) -> None:
        """Fail with DeadlineError unless there is an outcome. Thread: any."""
        if self.settle(None, self._deadline_error()):
            self._given_up()

    def _cancellation_error(self) -> EALError:
        return CallCancelledError(f"{self.describe()} was cancelled")

    def _deadline_error(self) -> EALError:
        return DeadlineError(f"{self.describe()} had no answer before its deadline")

    def _given_up(self) -> None:
        """Inform the other side that nobody waits for the answer."""

    # Waiting.

    @override
    def get(self, *, timeout: float | None = None) -> T:
        """Return the result, waiting until the deadline at most.

        Args:
            timeout: seconds of the clock to wait at most; the call itself continues after it.

        Raises:
            DeadlineError: the call's deadline passed.
            WaitTimeoutError: the time-out passed.
            CallCancelledError: the call was cancelled; or the caller's task was, which cancels the call.
            KeyboardInterrupt: Ctrl-C, which cancels the call.
            Exception: the call's own failure.

        Thread: blocks the caller. Never call it in an actor on a future of its parent or peer.
        """
        if self._get_hook is not None:
            return super().get(timeout=timeout)
        if not self._done:
            self._wait(timeout)
        if self._error is not None:
            raise self._error.with_traceback(self._traceback)
        return self._value  # type: ignore[no-any-return]  # set() takes any value; its caller knows the type

    def exception(self, *, timeout: float | None = None) -> BaseException | None:
        """Return the failure, or None for success, waiting like `get`. Thread: blocks the caller."""
        if not self._done:
            self._wait(timeout)
        return self._error

    def _wait(self, timeout: float | None) -> None:
        clock, limit = self.clock, self.deadline_s
        if timeout is not None:
            limit = min(clock.now() + timeout, math.inf if limit is None else limit)
        waiter = threading.Lock()  # as new_waiter, in every call
        waiter.acquire()
        with self._lock:
            if self._done:
                return
            if self._waiters is None:
                self._waiters = [waiter]
            else:
                self._waiters.append(waiter)
        remaining = None
        try:
            while limit is None or (remaining := limit - clock.now()) > 0:
                wait_in_scope(clock, waiter, remaining)
                if self._done:
                    return
        except (CallCancelledError, KeyboardInterrupt):
            self._remove_waiter(waiter)
            self.cancel()
            raise
        if self._done:
            return
        self._remove_waiter(waiter)
        if limit == self.deadline_s:
            self.expire()
        else:
            raise WaitTimeoutError(f"{self.describe()} had no answer within {timeout:g} s; the call continues")

    def _remove_waiter(self, waiter: threading.Lock) -> None:
        with self._lock:
            if self._waiters is not None and not self._done:
                self._waiters.remove(waiter)

    # Callbacks.

    def add_done_callback(self, callback: Callable[[Future[T]], None]) -> None:
        """Call back with this future when it is done, at once if it is. Errors of the callback are logged.

        Thread: the callback runs in the thread that finishes the future, so it must not block.
        """
        with self._lock:
            is_pending = not self._done
            if is_pending:
                if self._callbacks is None:
                    self._callbacks = []
                self._callbacks.append(callback)
        if is_pending:
            self.arm()
        else:
            self._run_callback(callback)

    def link(self, relay: Relay) -> None:
        """Pass the outcome to a relay as soon as there is one, at once if there is.

        Unlike a callback, a relay sets no timer: the caller watches the deadline or calls `arm`. Thread: any.
        """
        with self._lock:
            if not self._done:
                if self._relays is None:
                    self._relays = []
                self._relays.append(relay)
                return
        relay(self, None)

    def arm(self) -> None:
        """Set the deadline's timer at the timekeeper. Thread: any."""
        if self._timer is None and not self._done and self.timekeeper is not None and self.deadline_s is not None:
            timer = self.timekeeper.call_at(self.deadline_s, self.expire)
            with self._lock:
                if not self._done:
                    self._timer = timer
                    return
            timer.cancel()

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

    @override
    def __await__(self) -> Generator[Any, None, T]:
        """Wait for the result in an asyncio program; cancelling the task cancels the call."""
        return asyncio.wrap_future(self.to_concurrent()).__await__()

    __iter__ = None  # type: ignore[assignment]  # Pykka's yields None: `x, y, yaw = future` must say what is wrong

    def __eq__(self, other: object) -> bool:
        if isinstance(other, int | float | str):
            raise TypeError(f"a future is never equal to {other!r}; its result, which `get` returns, may be")
        return self is other

    def __bool__(self) -> NoReturn:
        raise TypeError("a future is neither true nor false; its result, which `get` returns, may be")

    __hash__ = object.__hash__

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> NoReturn:
            message = f"a future has no {name!r}; its result, which `get` returns, may have"
            raise AttributeError(message, name=name, obj=self)

    @override
    def map(self, func: Callable[[T], M]) -> Future[M]:
        """Return a future of the function's result on this one's.

        Thread: the function runs in the thread that finishes this future, so it must not block.
        """
        mapped: _MappedFuture[M] = _MappedFuture(self)

        def apply() -> None:
            if self._error is not None:
                mapped.set_exception(self._error)
                return
            try:
                mapped.set(func(self._value))
            except Exception as error:  # noqa: BLE001  # it is the outcome
                mapped.set_exception(error)

        self.link(lambda _, call_soon: apply() if call_soon is None else call_soon(apply))
        return mapped

    @override
    def set_get_hook(self, func: Callable[[float | None], T]) -> None:
        """Set Pykka's hook, which ActorRef.stop() needs. Hooked futures answer `get` alone; make others with `map`."""
        pykka.Future.__init__(self)
        super().set_get_hook(func)


class _MappedFuture(Future[T]):
    """The result of `Future.map`: cancelled and expired together with its source."""

    def __init__(self, source: Future[Any]) -> None:
        super().__init__(source.clock, source.deadline_s, source.timekeeper)
        self._source = source

    @override
    def describe(self) -> str:
        return self._source.describe()

    @override
    def expire(self) -> None:
        """Let the source fail with its own deadline first; its result may still wait for its turn to be mapped."""
        self._source.expire()
        super().expire()

    @override
    def _given_up(self) -> None:
        self._source.cancel()
