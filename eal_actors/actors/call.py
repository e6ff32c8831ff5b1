"""One call of one method, and the named slot through which it reaches whichever actor serves it now."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from functools import partial
from typing import Any, Final, Protocol, TypeAlias, TypeVar

from eal_actors.actors.feeds import Feed, Sink, StreamSpec
from eal_actors.actors.future import Future, Later
from eal_actors.actors.inbox import Envelope, Inbox
from eal_actors.device.info import ResourceInfo
from eal_actors.device.link import Link
from eal_actors.device.resource import Progress, Resource
from eal_actors.kernel import spans
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import (
    ArgumentError,
    CallCancelledError,
    DeadlineError,
    EALError,
    PreemptedError,
    StoppedError,
    UnavailableError,
)
from eal_actors.kernel.log import get_logger

T = TypeVar("T")

MOTION_METHODS: Final = frozenset({"send_cmd", "set_value", "write_comm"})
"""The calls that can move something: a halt drops them where they wait."""

_call_ids = itertools.count(1)
_watchers: tuple[Callable[[Call[Any]], None], ...] = ()
_watchers_lock = threading.Lock()


def watch_calls(watcher: Callable[[Call[Any]], None]) -> Callable[[], None]:
    """Show a watcher every call of this process as it is made, before it is on its way; for metrics.

    Args:
        watcher: must not block, nor raise; it may link to the call to learn of its outcome.

    Returns:
        What ends it; calling it twice is harmless.

    Thread: any; the watcher runs in the thread that makes the call.
    """
    global _watchers  # read by every call, so it must be cheap to read
    with _watchers_lock:
        _watchers = (*_watchers, watcher)
    return partial(_forget_watcher, watcher)


def _forget_watcher(watcher: Callable[[Call[Any]], None]) -> None:
    global _watchers
    with _watchers_lock:
        _watchers = tuple(other for other in _watchers if other is not watcher)


class Call(Future[T]):
    """A call under way: its own future, and its own envelope and message in the mailbox.

    Args:
        cell: the slot of the resource that is called.
        method: one of the nine methods, or `halt`.
        arguments: the method's arguments.
        timeout_s: seconds until the deadline.
    """

    reply_to = None
    begin_by_s: float | None = None
    """The fleet's time after which it must not begin any more; None for none."""
    start_s: float | None = None
    """The fleet's time at which to begin; None for at once."""
    began_s: float | None = None
    """The fleet's time at which it began, of a call with `start_s`; None as long as that is not known."""
    began_error_s: float = 0.0
    """By how many seconds at most `began_s` is wrong: over 0 where another machine's clock told it."""
    stamp_error_s: float = 0.0
    """By how many seconds at most the answer's `stamp_s` is wrong: over 0 where it is from another machine's clock."""
    caller: str = ""
    """Who called, where that is another process; empty for this one."""
    span: spans.Span | None = None
    """What it is to those who trace it; None where nobody does."""
    _progress: Progress | None = None
    _progress_callbacks: tuple[Callable[[Progress], None], ...] = ()

    def __init__(self, cell: ResourceCell, method: str, arguments: tuple[Any, ...], timeout_s: float) -> None:
        if timeout_s != timeout_s:  # not a number: it would never be over
            raise ArgumentError(f"timeout_s must be seconds, not {timeout_s!r}", robot=cell.robot, resource=cell.name)
        clock = cell.clock
        super().__init__(clock, clock.now() + timeout_s, cell.timekeeper)
        self.cell = cell
        self.method = method
        self.arguments = arguments
        self.timeout_s = timeout_s
        self.call_id = next(_call_ids)
        self.stops = False
        if spans.tracer is not None:
            self._trace(spans.tracer)
        if _watchers:
            for watcher in _watchers:
                watcher(self)

    def _trace(self, tracer: spans.Tracer) -> None:
        cell, text = self.cell, self.arguments[0] if self.arguments else None
        about = {"rpc.system": "eal", "rpc.service": cell.name, "rpc.method": self.method, "eal.robot": cell.robot}
        if isinstance(text, str):
            about["eal.command"] = text
        kind: spans.Kind = "internal" if cell.open_feed is None else "client"
        self.span = span = tracer.begin(f"{cell.name}/{self.method}", about, kind)
        if span is not None:
            self.link(lambda done, _: span.end(done.exception()))

    @property
    def message(self) -> Call[T]:
        """See Envelope."""
        return self

    def describe(self) -> str:
        """Return the call as `robot/resource: method 'argument'`."""
        return f"{self.cell.robot}/{self.cell.name}: {self.shown()}"

    def shown(self) -> str:
        """Return the call as `method 'argument'`."""
        return " ".join([self.method, *(repr(argument) for argument in self.arguments if argument is not None)])

    def progress(self) -> Progress | None:
        """Return how far it has come, as its resource told last; None if it told nothing. Thread: any."""
        return self._progress

    def add_progress_callback(self, callback: Callable[[Progress], None]) -> None:
        """Call back with what the resource tells of its progress, until the call is done; errors of it are logged.

        If there is something to tell, it is told at once. What follows quickly on one another may be left out.

        Thread: the callback runs in the thread that learns of it, so it must not block.
        """
        with self._lock:
            self._progress_callbacks = (*self._progress_callbacks, callback)
            known = self._progress
        if known is not None:
            self._tell_progress(callback, known)

    def note_progress(self, progress: Progress, later: Later | None = None) -> None:
        """Take in how far it has come: for whoever carries it out. `later` is as with `settle`. Thread: any."""
        with self._lock:
            if self._done:
                return
            self._progress = progress
            callbacks = self._progress_callbacks
        for callback in callbacks:
            if later is None:
                self._tell_progress(callback, progress)
            else:
                later(partial(self._tell_progress, callback, progress))

    def _tell_progress(self, callback: Callable[[Progress], None], progress: Progress) -> None:
        try:
            callback(progress)
        except (Exception, SystemExit, GeneratorExit):  # noqa: BLE001  # another's callback must not break the call
            get_logger().exception("a call's progress-callback raised", call=self.describe())

    def fail(self, error: BaseException) -> None:
        """Set the failure, naming the resource."""
        self._finish(None, error.at(self.cell.robot, self.cell.name) if isinstance(error, EALError) else error)

    def _cancelled(self) -> EALError:
        return CallCancelledError(f"{self.shown()} was cancelled").at(self.cell.robot, self.cell.name)

    def _expired(self) -> EALError:
        message = f"{self.shown()} had no answer within its {self.timeout_s:g} s"
        if self.cell.actor is None:
            message += f": {self.cell.error.message}"
        return DeadlineError(message).at(self.cell.robot, self.cell.name)

    def _given_up(self) -> None:
        self.cell.give_up(self)


class Mailbox(Protocol):
    """Where calls are put; see Inbox."""

    def put(self, envelope: Call[Any]) -> None:
        """Add to the normal lane. Thread: any; never blocks."""
        ...

    def put_urgent(
        self, envelope: Call[Any], *, bounded: bool = True, drop: Callable[[Envelope], bool] | None = None
    ) -> list[Envelope]:
        """Add to the urgent lane; returns what it drops from the normal lane. Thread: any; never blocks."""
        ...


class CallTarget(Protocol):
    """Who serves a resource's calls: its actor."""

    @property
    def actor_inbox(self) -> Mailbox:
        """Where calls are put."""
        ...

    @property
    def resource(self) -> Resource | None:
        """The resource itself, while it is open."""
        ...

    def stop_activity_of(self, call: Call[Any]) -> None:
        """Stop the activity that answers a call nobody waits for any more. Thread: any; does not block."""
        ...


class StopLatch:
    """Whether an emergency stop holds a robot. Thread: any."""

    __slots__ = ("reason",)

    def __init__(self) -> None:
        self.reason: str | None = None

    def set(self, reason: str) -> None:
        """Hold from now on; the first reason stands."""
        self.reason = self.reason or reason or "no reason given"

    def clear(self) -> None:
        """Hold no more."""
        self.reason = None

    def refuses(self, call: Call[Any]) -> bool:
        """Fail a call that could move something while the stop holds, and tell whether it was one."""
        if self.reason is None or call.method not in MOTION_METHODS or call.stops:
            return False
        call.fail(StoppedError(f"an emergency stop holds the robot until it is resumed: {self.reason}"))
        return True


class Follower(Protocol):
    """Who must know when a resource is gone for good: a stream."""

    def end(self, error: EALError) -> None:
        """Nothing comes any more. Thread: any; does not block."""
        ...


class ResourceCell:
    """The named slot of a resource on its robot: handles and callers keep it, restarts change what is in it.

    Written by the robot's actor alone; read by everybody.

    Attributes:
        actor: the actor that serves the resource now, or None.
        info: what the resource last said of itself; None before its first start.
        error: why calls fail while there is no actor.
        link: what calls pass on their way; a perfect one of its own if None is given.
        latch: the robot's emergency stop.
        open_feed: what brings values to streams; None where they are polled in this process.
    """

    def __init__(
        self,
        robot: str,
        name: str,
        clock: Clock,
        timekeeper: Inbox,
        timeout_s: float,
        link: Link | None = None,
        latch: StopLatch | None = None,
    ) -> None:
        self.robot = robot
        self.name = name
        self.clock = clock
        self.timekeeper = timekeeper
        self.timeout_s = timeout_s
        self.link = link if link is not None else Link(robot)
        self.latch = latch if latch is not None else StopLatch()
        self.actor: CallTarget | None = None
        self.info: ResourceInfo | None = None
        self.error: EALError = UnavailableError("it has not started yet")
        self.open_feed: OpenFeed | None = None
        self._streams: set[Follower] = set()
        self._is_closed = False

    def close(self, error: EALError) -> None:
        """Serve nothing more, and end the streams: nothing brings the resource back. Thread: its robot's actor."""
        self.error = error.copy()
        self.actor = None
        self._is_closed = True
        for stream in list(self._streams):
            stream.end(error)

    def join_stream(self, stream: Follower) -> None:
        """Tell a stream when everything is over. Thread: any."""
        self._streams.add(stream)
        if self._is_closed:
            stream.end(self.error)

    def leave_stream(self, stream: Follower) -> None:
        """Tell it no more. Thread: any."""
        self._streams.discard(stream)

    def submit(self, call: Call[Any]) -> None:
        """Put a call in the normal lane; a refusal becomes the call's outcome. Thread: any; never blocks."""
        if self.link.is_faulty:
            self.carry(lambda: self._submit(call))
        else:
            self._submit(call)

    def _submit(self, call: Call[Any]) -> None:
        actor = self.actor
        if self.latch.reason is not None and self.latch.refuses(call):
            return
        if actor is None:
            call.fail(self.unavailable())
            return
        try:
            actor.actor_inbox.put(call)
        except EALError as error:
            call.fail(error)

    def submit_urgent(self, call: Call[Any], *, stops: bool) -> None:
        """Put a call in the urgent lane.

        Args:
            call: the call.
            stops: it is a stop: never refused for a full lane, and the motions that wait are dropped.

        Thread: any; never blocks.
        """
        call.stops = stops
        if self.link.is_faulty:
            self.carry(lambda: self._submit_urgent(call))
        else:
            self._submit_urgent(call)

    def _submit_urgent(self, call: Call[Any]) -> None:
        stops, actor = call.stops, self.actor
        if actor is None:
            call.fail(self.unavailable())
            return
        try:
            dropped = actor.actor_inbox.put_urgent(call, bounded=not stops, drop=self._is_own_motion if stops else None)
        except EALError as error:
            call.fail(error)
            return
        for waiting in dropped:
            waiting.message.fail(PreemptedError(f"dropped by {call.shown()}"))

    def _is_own_motion(self, envelope: Envelope) -> bool:
        """Return whether it is a motion of this resource: a remote robot has one mailbox for all of its resources."""
        message = envelope.message
        return isinstance(message, Call) and message.cell is self and message.method in MOTION_METHODS

    def give_up(self, call: Call[Any]) -> None:
        """Tell the actor that nobody waits for the call any more. Thread: any; never blocks."""
        if self.link.is_faulty:
            self.carry(lambda: self._give_up(call))
        else:
            self._give_up(call)

    def _give_up(self, call: Call[Any]) -> None:
        if self.actor is not None:
            self.actor.stop_activity_of(call)

    def carry(self, deliver: Callable[[], None]) -> None:
        """Deliver something over the link: at once, later, or never. Thread: any; never blocks."""
        delay_s = 0.0 if self.name in self.link.spared else self.link.delay_of_next_s()
        if delay_s is None:
            return
        if delay_s:
            self.timekeeper.call_later(delay_s, lambda: self._arrive(deliver))
        else:
            deliver()

    def _arrive(self, deliver: Callable[[], None]) -> None:
        if not self.link.is_cut:  # what was on its way is lost with the rest
            deliver()

    def unavailable(self) -> EALError:
        """Return why calls fail now. Thread: any."""
        return self.error.copy().at(self.robot, self.name)


OpenFeed: TypeAlias = Callable[[ResourceCell, StreamSpec, Sink], Feed]
"""Opens a feed of a resource. Thread: any; does not block."""
