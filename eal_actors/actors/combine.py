"""Wait for many futures at once."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from eal_actors.actors.future import Future
from eal_actors.clock import REAL_TIME
from eal_actors.errors import CallError

T = TypeVar("T")


class _Combined(Future[T]):
    """A future made of others: giving it up gives up all of them."""

    def __init__(self, parts: list[Future[Any]], what: str) -> None:
        slowest = max(parts, key=lambda part: part.deadline_s or 0.0, default=None)
        endless = any(part.deadline_s is None for part in parts)
        super().__init__(
            clock=slowest.clock if slowest else REAL_TIME,
            deadline_s=slowest.deadline_s if slowest and not endless else None,
            timekeeper=slowest.timekeeper if slowest else None,
        )
        self._parts = parts
        self._what = what

    def describe(self) -> str:
        return f"{self._what} of {len(self._parts)} calls"

    def expire(self) -> None:
        """Let each part fail with its own deadline: its message says more."""
        for part in self._parts:
            part.expire()
        super().expire()

    def _abandoned(self) -> None:
        for part in self._parts:
            part.cancel()


def gather(futures: Iterable[Future[T]], *, return_exceptions: bool = False) -> Future[list[T]]:
    """Return a future of all results, in the order given.

    It is done when every part is, so that nothing is still under way behind the caller's back. It fails with the
    first failure in that order, unless `return_exceptions` puts failures in the list in place of results.

    Thread: any; does not block.
    """
    parts = list(futures)
    combined: _Combined[list[T]] = _Combined(parts, "gather")
    if not parts:
        combined.set([])
        return combined
    left = len(parts)
    lock = threading.Lock()

    def count(_: Future[T]) -> None:
        nonlocal left
        with lock:
            left -= 1
            if left:
                return
        errors = [part._error for part in parts]  # one family of classes
        first = next((error for error in errors if error is not None), None)
        if first is not None and not return_exceptions:
            combined.set_exception(first)
        else:
            combined.set([error or part._value for part, error in zip(parts, errors, strict=True)])

    for part in parts:
        part._link(count)  # one alarm for all of them: the combined future's
    return combined


def first(futures: Iterable[Future[T]]) -> Future[T]:
    """Return a future of the first success; the others are cancelled. It fails when all have failed.

    Raises:
        CallError: there is nothing to wait for.

    Thread: any; does not block.
    """
    parts = list(futures)
    if not parts:
        raise CallError("first() needs at least one future")
    combined: _Combined[T] = _Combined(parts, "first")
    left = len(parts)
    lock = threading.Lock()

    def look(part: Future[T]) -> None:
        nonlocal left
        with lock:
            left -= 1
            last = left == 0
        error = part._error  # one family of classes
        if error is None:
            if combined._finish(part._value, None):
                combined._abandoned()
        elif last:
            combined.set_exception(error)

    for part in parts:
        part._link(look)
    return combined


def as_completed(futures: Iterable[Future[T]]) -> Iterator[Future[T]]:
    """Yield the futures as they are done, each once; get() on them does not block.

    Thread: blocks the caller between futures, at most until the next deadline.
    """
    parts = list(futures)
    ready: queue.SimpleQueue[Future[T]] = queue.SimpleQueue()
    put: Callable[[Future[T]], None] = ready.put
    for part in parts:
        part.add_done_callback(put)
    for _ in parts:
        yield ready.get()
