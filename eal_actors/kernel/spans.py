"""Spans: what is under way, told to whoever traces it. Nobody does, and it costs nothing, before a tracer is there."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import Literal, Protocol, TypeAlias, TypeVar

Kind: TypeAlias = Literal["internal", "client"]
"""Within this process, or sent to another one."""
About: TypeAlias = Mapping[str, str | int | float | bool]

Y = TypeVar("Y")
R = TypeVar("R")


class Span(Protocol):
    """Something under way, from its making until `end`. Thread: any."""

    @property
    def traceparent(self) -> str:
        """How W3C Trace Context names it, for another process."""
        ...

    def current(self) -> AbstractContextManager[object]:
        """Return a block in which what this thread begins is a part of it."""
        ...

    def part(self, name: str) -> Span:
        """Begin a part of it."""
        ...

    def note(self, event: str) -> None:
        """Note that something happened."""
        ...

    def end(self, error: BaseException | None = None) -> None:
        """End it, with the error that it failed with."""
        ...


class Tracer(Protocol):
    """Who wants to know of spans. Thread: any; nothing blocks, nothing raises."""

    def begin(self, name: str, about: About, kind: Kind = "internal") -> Span | None:
        """Begin a part of what this thread is in; None where it is in nothing that is traced."""
        ...

    def begin_trace(self, name: str, about: About) -> Span:
        """Begin something that is a part of nothing."""
        ...

    def within(self, traceparent: str) -> AbstractContextManager[object]:
        """Return a block in which what this thread begins is a part of a span of another process."""
        ...


tracer: Tracer | None = None
"""Read where something begins; None as long as nobody traces."""


def install(wanted: Tracer) -> Callable[[], None]:
    """Trace this process from now on; returns what ends it."""
    global tracer  # read by every call, so it must be cheap to read
    before, tracer = tracer, wanted

    def end() -> None:
        global tracer
        tracer = before

    return end


def within(traceparent: str) -> AbstractContextManager[object]:
    """Return a block in which what this thread begins is a part of a span of another process, if it named one."""
    return tracer.within(traceparent) if traceparent and tracer is not None else nullcontext()


def during(span: Span | None, steps: Generator[Y, None, R]) -> Generator[Y, None, R]:
    """Go through a generator's steps so that what it begins is a part of a span, whatever runs between them."""
    if span is None:
        return (yield from steps)
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
