"""One call of one method, and the named slot that delivers it to the actor that serves the resource at present."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from functools import partial
from typing import Any, Final, Protocol, TypeAlias, TypeVar

from typing_extensions import override

from eal_actors.actors.feeds import Feed, Sink, StreamSpec
from eal_actors.actors.future import CallSoon, Future
from eal_actors.actors.inbox import Envelope, Inbox
from eal_actors.actors.stop_latch import StopLatch
from eal_actors.device.info import ResourceInfo
from eal_actors.device.link import FaultyLink
from eal_actors.device.resource import Progress, Resource
from eal_actors.kernel import spans
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import (
    ArgumentError,
    CallCancelledError,
    DeadlineError,
    EALError,
    PreemptedError,
    UnavailableError,
)
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.unwinding import AbandonedThread

T = TypeVar("T")

MOTION_METHODS: Final = frozenset({"send_cmd", "set_value", "write_comm"})
"""The methods that can move something: a halt drops their calls from the mailbox."""

_call_ids = itertools.count(1)
_watchers: tuple[Callable[[Call[Any]], None], ...] = ()
_watchers_lock = threading.Lock()


def watch_calls(watcher: Callable[[Call[Any]], None]) -> Callable[[], None]:
    """Show a watcher every call of this process when it is made, before it is sent; for metrics.

    Args:
        watcher: must not block or raise; it may link to the call to learn its outcome.

    Returns:
        A function that stops it; calling it twice is harmless.

    Thread: any; the watcher runs in the thread that makes the call.
    """
    global _watchers  # read by every call, so it must be cheap to read
    with _watchers_lock:
        _watchers = (*_watchers, watcher)
    return partial(_remove_watcher, watcher)


def _remove_watcher(watcher: Callable[[Call[Any]], None]) -> None:
    global _watchers
    with _watchers_lock:
        _watchers = tuple(other for other in _watchers if other is not watcher)


class Call(Future[T]):
    """A call: its own future, and its own envelope and message in the mailbox.

    Args:
        method: one of the nine methods, or `halt`.
    """

    reply_to = None
    begin_by_s: float | None = None
    """The latest time of the fleet's clock to begin it; None for no limit."""
    start_s: float | None = None
    """The time of the fleet's clock to begin it; None for at once."""
    began_s: float | None = None
    """The time of the fleet's clock at which a call with `start_s` began; None as long as that is unknown."""
    began_error_s: float = 0.0
    """The greatest error of `began_s` in seconds: over 0 where it comes from another machine's clock."""
    stamp_error_s: float = 0.0
    """The greatest error of the answer's `stamp_s` in seconds: over 0 where it is from another machine's clock."""
    stops: bool = False  # a stop overtakes everything that waits
    caller: str = ""
    """The name of the calling process if it is another one; empty for this one."""
    span: spans.Span | None = None
    """The call's trace span; None while no tracer is installed."""
    _progress: Progress | None = None
    _progress_callbacks: tuple[Callable[[Progress], None], ...] = ()

    def __init__(self, cell: ResourceCell, method: str, arguments: tuple[Any, ...], timeout_s: float) -> None:
        if timeout_s != timeout_s:  # NaN: the deadline would never pass
            raise ArgumentError(f"timeout_s must be seconds, not {timeout_s!r}", robot=cell.robot, resource=cell.name)
        clock = self.clock = cell.clock  # what Future.__init__ does: every call is made here
        self.deadline_s = clock.now() + timeout_s
        self.timekeeper = cell.timekeeper
        self._lock = threading.Lock()
        self.cell = cell
        self.method = method
        self.arguments = arguments
        self.timeout_s = timeout_s
        self.call_id = next(_call_ids)
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
        """The message of this envelope: the call itself."""
        return self

    @override
    def describe(self) -> str:
        """Return the call as `robot/resource: method 'argument'`."""
        return f"{self.cell.robot}/{self.cell.name}: {self.text()}"

    def text(self) -> str:
        """Return the call as `method 'argument'`."""
        return " ".join([self.method, *(repr(argument) for argument in self.arguments if argument is not None)])

    def progress(self) -> Progress | None:
        """Return the progress that its resource reported last; None if it reported none. Thread: any."""
        return self._progress

    def add_progress_callback(self, callback: Callable[[Progress], None]) -> None:
        """Call back with each progress report until the call is done; errors of the callback are logged.

        A report that is there already is passed on at once. Reports in quick succession may be skipped.

        Thread: the callback runs in the thread that receives the report, so it must not block.
        """
        with self._lock:
            self._progress_callbacks = (*self._progress_callbacks, callback)
            known = self._progress
        if known is not None:
            self._run_progress_callback(callback, known)

    def note_progress(self, progress: Progress, call_soon: CallSoon | None = None) -> None:
        """Record a progress report, as the executing side does; `call_soon` as in `settle`. Thread: any."""
        with self._lock:
            if self._done:
                return
            self._progress = progress
            callbacks = self._progress_callbacks
        for callback in callbacks:
            if call_soon is None:
                self._run_progress_callback(callback, progress)
            else:
                call_soon(partial(self._run_progress_callback, callback, progress))

    def _run_progress_callback(self, callback: Callable[[Progress], None], progress: Progress) -> None:
        try:
            callback(progress)
        except (KeyboardInterrupt, AbandonedThread):  # they are meant for this thread
            raise
        except BaseException:  # noqa: BLE001  # user code must not break the call
            get_logger().exception("a call's progress-callback raised", call=self.describe())

    @override
    def fail(self, error: BaseException) -> None:
        """Set the failure, naming the resource."""
        self.settle(None, error.at(self.cell.robot, self.cell.name) if isinstance(error, EALError) else error)

    @override
    def _cancellation_error(self) -> EALError:
        return CallCancelledError(f"{self.text()} was cancelled").at(self.cell.robot, self.cell.name)

    @override
    def _deadline_error(self) -> EALError:
        message = f"{self.text()} had no answer within its {self.timeout_s:g} s"
        if (real_s := self.timeout_s / self.clock.of_real(1.0)) < self.timeout_s:
            message += f", {real_s:g} s of real time"
        if self.cell.actor is None:
            message += f": {self.cell.error.message}"
        return DeadlineError(message).at(self.cell.robot, self.cell.name)

    @override
    def _given_up(self) -> None:
        self.cell.give_up(self)


class CallServer(Protocol):
    """Serves the calls of a resource: its actor in this process, or the call queue of a remote robot."""

    def put(self, envelope: Call[Any], /) -> None:
        """Add a call to the normal lane; see `Inbox.put`. Thread: any; never blocks."""

    def put_urgent(
        self, envelope: Call[Any], /, *, bounded: bool = True, drop: Callable[[Envelope], bool] | None = None
    ) -> list[Envelope]:
        """Add a call to the urgent lane; see `Inbox.put_urgent`. Thread: any; never blocks."""

    @property
    def resource(self) -> Resource | None:
        """The resource itself while it is open."""

    def stop_activity_of(self, call: Call[Any]) -> None:
        """Stop the activity of a call that nobody waits for. Thread: any; does not block."""


class ResourceCell:
    """The named slot of a resource on its robot. Handles keep the slot; a restart changes the actor in it.

    Written by the robot's actor alone; read by any thread.

    Attributes:
        actor: the actor that serves the resource at present, or None.
        info: the resource's latest information about itself; None before its first start.
        error: the error of calls while there is no actor.
        link: the link that calls pass; a faultless one of its own if None is given.
        owes_halt: whether a halt was accepted while the device was absent, and is still to be carried out.
        serve_now: runs a call in the caller's thread and returns True, if its actor is idle; None if the resource must
            have its own thread, or is in another process.
        read_now: the same for readings by controllers, of a resource that implements `glance`: its values take no time.
        open_feed: opens a feed of a remote resource; None where streams poll in this process.
        denied: returns why the robot does not grant this program a method of a remote resource, None if it does.
    """

    def __init__(
        self,
        robot: str,
        name: str,
        clock: Clock,
        timekeeper: Inbox,
        timeout_s: float,
        link: FaultyLink | None = None,
        latch: StopLatch | None = None,
    ) -> None:
        self.robot = robot
        self.name = name
        self.clock = clock
        self.timekeeper = timekeeper
        self.timeout_s = timeout_s
        self.link = link if link is not None else FaultyLink(robot)
        self.latch = latch if latch is not None else StopLatch()
        self.actor: CallServer | None = None
        self.info: ResourceInfo | None = None
        self.error: EALError = UnavailableError("it has not started yet")
        self.owes_halt = False
        self.serve_now: Callable[[Call[Any]], bool] | None = None
        self.read_now: Callable[[Call[Any]], bool] | None = None
        self.open_feed: OpenFeed | None = None
        self.denied: Callable[[str], str | None] = lambda _: None
        self._close_callbacks: set[Callable[[EALError], None]] = set()
        self._is_closed = False

    def close(self, error: EALError) -> None:
        """Close the slot for good and end the streams. Thread: its robot's actor."""
        self.error = error.copy()
        self.actor = self.serve_now = self.read_now = None
        self._is_closed = True
        for callback in list(self._close_callbacks):
            callback(error)

    def add_close_callback(self, callback: Callable[[EALError], None]) -> None:
        """Call back when the slot is closed for good, at once if it is. Thread: any."""
        self._close_callbacks.add(callback)
        if self._is_closed:
            callback(self.error)

    def remove_close_callback(self, callback: Callable[[EALError], None]) -> None:
        """Remove a callback; harmless if it is not there. Thread: any."""
        self._close_callbacks.discard(callback)

    def submit(self, call: Call[Any], *, among_many: bool = False, has_arrived: bool = False) -> None:
        """Put a call in the normal lane, or run it at once; a refusal becomes the call's outcome.

        For one `among_many` see `Clock.spares_turn`; one that `has_arrived` has passed the link.

        Thread: any; never blocks.
        """
        if not has_arrived:
            if self.link.is_faulty:
                self.carry(lambda: self.submit(call, has_arrived=True))
                return
            if (serve_now := self.serve_now) and self.clock.spares_turn(among_many=among_many) and serve_now(call):
                return
        actor = self.actor
        if self.latch.reason is not None and self.refuses(call):
            return
        if actor is None:
            call.fail(self.unavailable())
            return
        try:
            actor.put(call)
        except EALError as error:
            call.fail(error)

    def refuses(self, call: Call[Any]) -> bool:
        """Fail a call that could move something while a stop is latched; return whether it did."""
        if self.latch.reason is None or call.method not in MOTION_METHODS or call.stops:
            return False
        call.fail(self.latch.refusal())
        return True

    def explain(self, end: str) -> str:
        """Return the message for a command that has ended; it contains the reason of the stop while one is latched."""
        return end if self.latch.reason is None else f"{end}: {self.latch.explanation}"

    def submit_urgent(self, call: Call[Any], *, stops: bool) -> None:
        """Put a call in the urgent lane. A full lane never refuses one that stops, and it drops the motions that wait.

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
            dropped = actor.put_urgent(call, bounded=not stops, drop=self._is_own_motion if stops else None)
        except EALError as error:
            call.fail(error)
            return
        for envelope in dropped:
            envelope.message.fail(PreemptedError(self.explain(f"dropped by {call.text()}")))

    def _is_own_motion(self, envelope: Envelope) -> bool:
        """Return whether it is a motion of this resource: a remote robot has one mailbox for all of its resources."""
        message = envelope.message
        return isinstance(message, Call) and message.cell is self and message.method in MOTION_METHODS

    def give_up(self, call: Call[Any]) -> None:
        """Inform the actor that nobody waits for the call. Thread: any; never blocks."""
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
        if not self.link.is_cut:  # a cut loses messages in transit too
            deliver()

    def unavailable(self) -> EALError:
        """Return the reason why calls fail at present. Thread: any."""
        return self.error.copy().at(self.robot, self.name)


OpenFeed: TypeAlias = Callable[[ResourceCell, StreamSpec, Sink], Feed]
"""Opens a feed of a resource. Thread: any; does not block."""
