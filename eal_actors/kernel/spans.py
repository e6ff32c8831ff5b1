"""Trace spans: the interface of a tracer, without one. Nothing is traced, at no cost, until `install` is called."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import Literal, Protocol, TypeAlias, TypeVar

Kind: TypeAlias = Literal["internal", "client"]
"""A span within this process, or of a call to another one."""
About: TypeAlias = Mapping[str, str | int | float | bool]
"""The attributes of a span."""

Y = TypeVar("Y")
R = TypeVar("R")


class Span(Protocol):
    """An operation, from its creation until `end`. Thread: any."""

    @property
    def traceparent(self) -> str:
        """Its name in W3C Trace Context, for another process."""

    def current(self) -> AbstractContextManager[object]:
        """Return a context in which the spans that this thread begins are parts of it."""

    def part(self, name: str) -> Span:
        """Begin a part of it, a child span."""

    def note(self, event: str) -> None:
        """Record an event."""

    def end(self, error: BaseException | None = None) -> None:
        """End it, with its error if it failed."""


class Tracer(Protocol):
    """Creates spans. Thread: any; no method blocks or raises."""

    def begin(self, name: str, about: About, kind: Kind = "internal") -> Span | None:
        """Begin a part of this thread's current span; return None if it has none."""

    def begin_trace(self, name: str, about: About) -> Span:
        """Begin a root span."""

    def within(self, traceparent: str) -> AbstractContextManager[object]:
        """Return a context in which the spans that this thread begins are parts of another process's span."""


tracer: Tracer | None = None
"""The installed tracer, or None."""


def install(installed: Tracer) -> Callable[[], None]:
    """Trace this process from now on; return a function that stops it."""
    global tracer  # read by every call, so it must be cheap to read
    before, tracer = tracer, installed

    def uninstall() -> None:
        global tracer
        tracer = before

    return uninstall


def within(traceparent: str) -> AbstractContextManager[object]:
    """Return a context in which the spans of this thread are parts of another process's span, if it named one."""
    return tracer.within(traceparent) if traceparent and tracer is not None else nullcontext()


def during(span: Span, steps: Generator[Y, None, R]) -> Generator[Y, None, R]:
    """Run a generator's steps so that the spans they begin are parts of a span, whatever runs between the steps."""
    try:
        while True:
            with span.current():
                try:
                    step = next(steps)
                except StopIteration as end:
                    result: R = end.value
                    return result
            yield step
    finally:
        steps.close()
