"""Functions that wait for many futures at once."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any, TypeVar

from typing_extensions import override

from eal_actors.actors.future import CallSoon, Future, Relay
from eal_actors.kernel.clock import REAL_TIME, new_waiter, wait_in_scope
from eal_actors.kernel.errors import CallCancelledError, CallError

T = TypeVar("T")


class _CombinedFuture(Future[T]):
    """A future made of others: cancelling it cancels all of them.

    `what` is the function that combines them; `watched` are those that count, all if None.
    """

    def __init__(self, parts: list[Future[Any]], what: str, watched: list[Future[Any]] | None = None) -> None:
        pending = [part for part in parts if not part.done()]
        slowest = max(pending, key=lambda part: part.deadline_s or 0.0, default=None)
        endless = any(part.deadline_s is None for part in pending) or len({id(part.clock) for part in pending}) > 1
        super().__init__(
            clock=slowest.clock if slowest is not None else REAL_TIME,
            deadline_s=slowest.deadline_s if slowest is not None and not endless else None,
            timekeeper=slowest.timekeeper if slowest is not None else None,
        )
        self._parts = parts
        self._watched = parts if watched is None else watched
        self._what = what
        self._left = len(self._watched)
        self._count_lock = threading.Lock()
        self._needs_one_timer = not endless and len({id(part.timekeeper) for part in pending}) <= 1

    def watch(self, relay: Relay) -> None:
        """Link to each part. Parts of one clock and one mailbox need one timer only, that of the combined future."""
        for part in self._watched:
            part.link(relay)
            if not self._needs_one_timer:
                part.arm()

    def count_down(self) -> bool:
        """Count a part that is done; return whether it was the last one. Thread: any."""
        with self._count_lock:
            self._left -= 1
            return not self._left

    @override
    def describe(self) -> str:
        return f"{self._what} of {len(self._parts)} calls"

    @override
    def expire(self) -> None:
        """Let each part fail with its own deadline first: its message says more."""
        for part in self._parts:
            part.expire()
        super().expire()

    @override
    def _given_up(self) -> None:
        for part in self._parts:
            part.cancel()


def _all_or_none(futures: Iterable[Future[T]]) -> list[Future[T]]:
    """Return the futures; if making one of them fails, cancel those made so far."""
    parts: list[Future[T]] = []
    try:
        parts.extend(futures)
    except BaseException:
        for part in parts:
            part.cancel()
        raise
    return parts


def gather(futures: Iterable[Future[T]], *, return_exceptions: bool = False) -> Future[list[T]]:
    """Return a future of all results, in the order given.

    It is done when every part is, so that nothing still runs behind the caller's back. It fails with the first failure
    in that order, unless `return_exceptions` puts failures in the list in place of results. Thread: any; does not
    block.
    """
    parts = _all_or_none(futures)
    pending = [part for part in parts if not part.done()]  # the others need no link
    combined: _CombinedFuture[list[T]] = _CombinedFuture(parts, "gather", pending)

    def settle(call_soon: CallSoon | None) -> None:
        errors = [part._error for part in parts]  # one family of classes
        failure = next((error for error in errors if error is not None), None)
        if failure is not None and not return_exceptions:
            combined.settle(None, failure, call_soon)
        else:
            results = [error or part._value for part, error in zip(parts, errors, strict=True)]
            combined.settle(results, None, call_soon)

    def count(_: Future[T], call_soon: CallSoon | None) -> None:
        if combined.count_down():
            settle(call_soon)

    if pending:
        combined.watch(count)
    else:
        settle(None)
    return combined


def first(futures: Iterable[Future[T]]) -> Future[T]:
    """Return a future of the first success and cancel the others. It fails when all have failed.

    Raises CallError if there is no future. Thread: any; does not block.
    """
    parts = _all_or_none(futures)
    if not parts:
        raise CallError("first() needs at least one future")
    combined: _CombinedFuture[T] = _CombinedFuture(parts, "first")

    def check(part: Future[T], call_soon: CallSoon | None) -> None:
        is_last = combined.count_down()
        error = part._error  # one family of classes
        if error is None:
            if combined.settle(part._value, None, call_soon):
                cancel_parts = combined._given_up
                cancel_parts() if call_soon is None else call_soon(cancel_parts)
        elif is_last:
            combined.settle(None, error, call_soon)

    combined.watch(check)
    return combined


def as_completed(futures: Iterable[Future[T]]) -> Iterator[Future[T]]:
    """Yield each future once, when it is done; get() on it does not block.

    Ctrl-C and the cancellation of the caller's task cancel all of them.

    Thread: blocks the caller between futures, at most until the next deadline.
    """
    parts = _all_or_none(futures)
    ready: deque[Future[T]] = deque()
    waiter = new_waiter()
    clock = parts[0].clock if parts else REAL_TIME

    def note(part: Future[T], _: CallSoon | None) -> None:
        ready.append(part)
        clock.wake(waiter)

    for part in parts:
        part.link(note)
        part.arm()
    for _ in parts:
        try:
            while not ready:
                wait_in_scope(clock, waiter, None)
        except (CallCancelledError, KeyboardInterrupt):
            for part in parts:
                part.cancel()
            raise
        yield ready.popleft()
