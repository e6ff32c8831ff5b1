"""The newest value of a resource, again and again: the stream for a reader of any speed, and the feed that polls."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from typing import Final, Self

from typing_extensions import override

from eal_actors.actors.call import Call, ResourceCell
from eal_actors.actors.feeds import Feed, Item, Sink, StreamSpec
from eal_actors.actors.future import Future
from eal_actors.device.data import EALData
from eal_actors.kernel.clock import new_waiter, wait_in_scope
from eal_actors.kernel.errors import (
    ArgumentError,
    BusyError,
    DeadlineError,
    EALError,
    ResourceFaultError,
    UnavailableError,
    error_text,
)

_TRANSIENT: Final = (UnavailableError, BusyError, DeadlineError)
"""The errors that interrupt a stream for a while; a reader waits for the next value."""

_POLL_TIMEOUT_S: Final = 30.0
"""Real seconds that a polled value may take. No caller waits for a single one, so a camera that is slow on a busy
machine must not be restarted for being late, only a resource that hangs."""
_LOST_S: Final = 2.0  # seconds beyond a period after which a poll over a faulty link counts as lost


class Stream(Iterator[EALData]):
    """Values of one resource as they arrive, the newest first and each at most once.

        with robot["Camera"].stream(rate_hz=10, encoding="jpeg") as frames:
            for frame in frames:
                show(frame.value)

    It keeps the newest value only: a reader slower than the resource misses some and never gets an old one. Every value
    has a `stamp_s` in seconds of the reader's fleet clock: the resource's time stamp, else the time of reading, so
    `fleet.clock.now() - value.stamp_s` is its age.

    While the resource restarts or the robot is lost, a reader waits, at most for the time-out; a later read continues
    once the robot is back. The resource and its robot serve a stream until it is closed. `next` waits `timeout_s`
    seconds of the fleet's clock at most.

    Raises:
        ArgumentError: the encoding cannot carry the resource's values; or `timeout_s` is NaN.
        UnsupportedError: the resource has no value; or OpenCV is needed and not installed.

    Thread: any. Several readers of one stream share its values; open a stream for each instead.
    """

    def __init__(self, cell: ResourceCell, spec: StreamSpec, timeout_s: float) -> None:
        if timeout_s != timeout_s:  # NaN: a reader would wait for ever
            raise ArgumentError(f"timeout_s must be seconds, not {timeout_s!r}", robot=cell.robot, resource=cell.name)
        if cell.info is not None:
            try:
                spec.check_resource(cell.info)
            except EALError as error:
                raise error.at(cell.robot, cell.name) from None
        self.spec: Final = spec
        self._cell = cell
        self._timeout_s = timeout_s
        self._lock = threading.Lock()
        self._item: Item | None = None
        self._waiters: list[threading.Lock] = []
        self._skipped = 0
        self._latest_error: EALError | None = None
        self._ended_by: EALError | None = None
        self._is_closed = False
        self._feed: Feed = (cell.open_feed or PolledFeed)(cell, spec, self._offer)
        cell.add_close_callback(self._end)

    def __repr__(self) -> str:
        state = "closed" if self._is_closed else "open"
        return f"<Stream {self._cell.robot}/{self._cell.name} at {self.spec.rate_hz:g} Hz: {state}>"

    @property
    def skipped(self) -> int:
        """The number of values that newer ones replaced before they were read."""
        return self._skipped

    @override
    def __next__(self) -> EALData:
        """Return the newest value, waiting for one that is newer than the last.

        Raises:
            StopIteration: the stream is closed.
            UnavailableError: the robot is disconnected or has failed; or it was out of reach until the time-out.
            DeadlineError: no value arrived until the time-out.
            CallCancelledError: the caller's task was cancelled.
            EALError: get_value failed.

        Thread: blocks the caller.
        """
        clock = self._cell.clock
        end_s = clock.now() + self._timeout_s
        while True:
            with self._lock:
                if self._is_closed:
                    raise StopIteration
                item, self._item = self._item, None
                if item is None:
                    if self._ended_by is not None:
                        raise self._ended_by.copy()
                    waiter = new_waiter()
                    self._waiters.append(waiter)
            if item is not None:
                if (value := self._open(item)) is not None:
                    return value
                continue
            left_s = end_s - clock.now()
            if left_s > 0:
                wait_in_scope(clock, waiter, left_s)
            with self._lock:
                if waiter in self._waiters:  # the time passed
                    self._waiters.remove(waiter)
                    if clock.now() >= end_s:
                        raise self._timeout_error()

    def _open(self, item: Item) -> EALData | None:
        """Return the value of an item, or None for a transient error."""
        try:
            if isinstance(item, EALError):
                raise item.copy()
            value = item if isinstance(item, EALData) else item()
        except _TRANSIENT as error:
            self._latest_error = error.at(self._cell.robot, self._cell.name)
            return None
        except EALError as error:
            error.at(self._cell.robot, self._cell.name)
            raise
        self._latest_error = None
        return value

    def _timeout_error(self) -> EALError:
        if self._cell.actor is None:
            return self._cell.unavailable()
        if self._latest_error is not None:
            return self._latest_error.copy()
        message = f"no new value came within {self._timeout_s:g} s"
        return DeadlineError(message, robot=self._cell.robot, resource=self._cell.name)

    def _offer(self, item: Item) -> None:
        """Replace the unread item. Thread: the feed's; does not block."""
        with self._lock:
            if self._is_closed:
                return
            if self._item is not None:
                self._skipped += 1
            self._item = item
        self._wake()

    def _end(self, error: EALError) -> None:
        """End with an error, which is raised after the unread value. Thread: any."""
        with self._lock:
            self._ended_by = error.copy().at(self._cell.robot, self._cell.name)
        self._feed.close()
        self._wake()

    def _wake(self) -> None:
        with self._lock:
            waiters, self._waiters = self._waiters, []
        for waiter in waiters:
            self._cell.clock.wake(waiter)

    def close(self) -> None:
        """End the stream; waiting readers get StopIteration. Calling it twice is harmless. Thread: any."""
        with self._lock:
            self._is_closed = True
            self._item = None
        self._cell.remove_close_callback(self._end)
        self._feed.close()
        self._wake()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exc_info: object) -> None:
        self.close()


class PolledFeed:
    """The feed of a resource in this process: one get_value call at a time, which waits in the mailbox like all others.

    The polls keep to a grid of whole periods from the first one. If an answer takes longer than a period, the polls of
    the meantime are skipped, so that a slow resource is never overloaded. Thread: the timekeeper's and the resource's.
    """

    def __init__(self, cell: ResourceCell, spec: StreamSpec, sink: Sink) -> None:
        self._cell = cell
        self._spec = spec
        self._sink = sink
        self._start_s = cell.clock.now()
        self._count = 0
        self._is_closed = False
        self._timeout_s = max(cell.timeout_s, cell.clock.of_real(_POLL_TIMEOUT_S))
        self._timer = cell.timekeeper.call_at(self._start_s, self._poll)

    def close(self) -> None:
        """Stop polling. Thread: any."""
        self._is_closed = True
        self._timer.cancel()

    def _poll(self) -> None:
        if self._is_closed:
            return
        call: Call[EALData] = Call(self._cell, "get_value", (), self._timeout_s)
        self._cell.submit(call)
        if self._cell.link.is_faulty:
            self._cell.timekeeper.call_later(self._spec.period_s + _LOST_S, call.expire)
        call.add_done_callback(self._deliver)

    def _deliver(self, call: Future[EALData]) -> None:
        if self._is_closed:
            return
        now_s = self._cell.clock.now()
        if (error := call.exception()) is None:
            self._sink(self._check(call.get(), now_s))
        else:
            self._sink(error if isinstance(error, EALError) else ResourceFaultError(error_text(error)))
        elapsed = math.floor((now_s - self._start_s) / self._spec.period_s)
        self._count = max(self._count, elapsed) + 1
        self._timer = self._cell.timekeeper.call_at(self._start_s + self._count * self._spec.period_s, self._poll)
        if self._is_closed:  # just now, by another thread, which has cancelled the timer before
            self._timer.cancel()

    def _check(self, data: EALData, now_s: float) -> EALData | EALError:
        """Return the value with a time stamp, or why the encoding cannot carry it."""
        try:
            self._spec.check_value(data)
        except EALError as error:
            return error.at(self._cell.robot, self._cell.name)
        return data if data.stamp_s is not None else data.with_meta(stamp_s=now_s)
