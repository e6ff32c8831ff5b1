"""Stream: the newest value of a resource, again and again, for a reader of whatever speed."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from types import TracebackType
from typing import Final, Self

from eal_actors.actors.call import ResourceCell
from eal_actors.actors.feeds import Item, StreamSpec
from eal_actors.actors.polling import PolledFeed
from eal_actors.device.data import EALData
from eal_actors.kernel.clock import new_waiter, wait_in_scope
from eal_actors.kernel.errors import BusyError, DeadlineError, EALError, UnavailableError

_PASSING: Final = (UnavailableError, BusyError, DeadlineError)
"""What keeps values away for a while: a reader waits over it."""


class Stream(Iterator[EALData]):
    """Values of one resource as they come, the newest first and each at most once.

        with robot["Camera"].stream(rate_hz=10, encoding="jpeg") as frames:
            for frame in frames:
                show(frame.value)

    It keeps one value, the newest: a reader that is slower than the resource misses some, and never gets an old one.
    Every value has a `stamp_s` in seconds of the reader's fleet clock: the time that the resource gave, else when
    it was read, so `fleet.clock.now() - value.stamp_s` is its age.

    While the resource restarts or the robot is lost, a reader waits, at most for the time-out; reading again afterwards
    goes on where the robot is back. The resource and its robot work for a stream until it is closed.

    Args:
        cell: the slot of the resource.
        spec: what is wanted.
        timeout_s: seconds of the fleet's clock that `next` waits at most.

    Raises:
        ArgumentError: the resource's values cannot travel in the encoding.
        UnsupportedError: the resource has no value; or OpenCV is wanted and not installed.

    Thread: any. Of several readers of one stream, each value goes to one; open a stream for each instead.
    """

    def __init__(self, cell: ResourceCell, spec: StreamSpec, timeout_s: float) -> None:
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
        self._trouble: EALError | None = None
        self._ended_by: EALError | None = None
        self._is_closed = False
        self._feed = (cell.open_feed or PolledFeed)(cell, spec, self)
        cell.join_stream(self)

    def __repr__(self) -> str:
        state = "closed" if self._is_closed else "open"
        return f"<Stream {self._cell.robot}/{self._cell.name} at {self.spec.rate_hz:g} Hz: {state}>"

    @property
    def skipped(self) -> int:
        """How many values came and were replaced by newer ones before anybody read them."""
        return self._skipped

    def __next__(self) -> EALData:
        """Return the newest value, waiting for one that is newer than the last.

        Raises:
            StopIteration: the stream is closed.
            UnavailableError: the robot is disconnected or has failed; or it was out of reach until the time-out.
            DeadlineError: no value came until the time-out.
            CallCancelledError: the caller's task was cancelled.
            EALError: what get_value failed with.

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
                value = self._opened(item)
                if value is not None:
                    return value
                continue
            left_s = end_s - clock.now()
            if left_s > 0:
                wait_in_scope(clock, waiter, left_s)
            with self._lock:
                if waiter in self._waiters:  # nobody has woken it
                    self._waiters.remove(waiter)
                    if clock.now() >= end_s:
                        raise self._reason()

    def _opened(self, item: Item) -> EALData | None:
        """Return the value of an item, or None where there is nothing but trouble that passes."""
        try:
            if isinstance(item, EALError):
                raise item.copy()
            value = item if isinstance(item, EALData) else item()
        except _PASSING as error:
            self._trouble = error.at(self._cell.robot, self._cell.name)
            return None
        except EALError as error:
            error.at(self._cell.robot, self._cell.name)
            raise
        self._trouble = None
        return value

    def _reason(self) -> EALError:
        if self._cell.actor is None:
            return self._cell.unavailable()
        if self._trouble is not None:
            return self._trouble.copy()
        message = f"no new value came within {self._timeout_s:g} s"
        return DeadlineError(message, robot=self._cell.robot, resource=self._cell.name)

    # What the feed and the cell tell.

    def offer(self, item: Item) -> None:
        """See Sink."""
        with self._lock:
            if self._is_closed:
                return
            if self._item is not None:
                self._skipped += 1
            self._item = item
        self._wake()

    def end(self, error: EALError) -> None:
        """There will be nothing more: what is still unread can be read, then the error is raised. Thread: any."""
        with self._lock:
            self._ended_by = error.copy().at(self._cell.robot, self._cell.name)
        self._feed.close()
        self._wake()

    def _wake(self) -> None:
        with self._lock:
            waiters, self._waiters = self._waiters, []
        for waiter in waiters:
            self._cell.clock.wake(waiter)

    # The end.

    def close(self) -> None:
        """End the stream; whoever waits for a value gets StopIteration. Calling it twice is harmless. Thread: any."""
        with self._lock:
            self._is_closed = True
            self._item = None
        self._cell.leave_stream(self)
        self._feed.close()
        self._wake()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()
