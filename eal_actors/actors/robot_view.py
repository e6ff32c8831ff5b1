"""The state of a robot connection that any thread may read, and the interface of the actors behind it."""

from __future__ import annotations

import enum
import os
import socket
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib.metadata import version
from typing import Any, Protocol

from typing_extensions import override

from eal_actors.actors.actor import EALActor
from eal_actors.actors.call import Call, ResourceCell
from eal_actors.actors.future import Future, Timekeeper
from eal_actors.actors.inbox import Inbox
from eal_actors.actors.stop_latch import StopLatch
from eal_actors.device.resource import Progress
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import ArgumentError, DeadlineError, EALError, UnavailableError
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.posix import user_name
from eal_actors.kernel.unwinding import AbandonedThread


@cache
def release() -> str:
    """Return the release of the framework."""
    return version("eal-actors")


def process_name(who: str | None = None) -> str:
    """Return the name of this process for people: `anna@lab-pc (pid 4711)`, by its certificate, else its user."""
    return f"{who or user_name()}@{socket.gethostname()} (pid {os.getpid()})"


class RobotState(enum.Enum):
    """The state of a robot connection."""

    STARTING = "starting"
    READY = "ready"
    LOST = "lost"
    """It was ready and is out of reach; the framework looks for it and reconnects by itself."""
    FAILED = "failed"
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True)
class RunningCommand:
    """A command that a robot executes at present.

    Attributes:
        command: its text, or the method where that is not `send_cmd`.
        by: the name of the process that sent it.
        since_s: when it began, by the fleet's clock.
        progress: its latest progress report; None if there is none.
    """

    resource: str
    command: str
    by: str
    since_s: float
    progress: Progress | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        return asdict(self)


def command_of(call: Call[Any]) -> str:
    """Return the text of a command, or the method of another call."""
    return str(call.arguments[0]) if call.method == "send_cmd" else call.method


@dataclass(frozen=True, slots=True)
class MailboxLoad:
    """The calls that wait in a mailbox.

    `oldest_s` is seconds of the fleet's clock since the oldest was made; 0 if none waits.
    """

    count: int
    oldest_s: float


def mailbox_load(cell: ResourceCell) -> MailboxLoad | None:
    """Return the load of a resource's mailbox; None if that is in another process. Thread: any; does not block."""
    if (actor := cell.actor) is None:
        return MailboxLoad(0, 0.0)
    if not isinstance(actor, EALActor):
        return None
    made_s = [
        call.deadline_s - call.timeout_s
        for call in (envelope.message for envelope in actor.actor_inbox.waiting())
        if isinstance(call, Call) and call.deadline_s is not None
    ]
    return MailboxLoad(len(made_s), max(0.0, cell.clock.now() - min(made_s)) if made_s else 0.0)


@dataclass(frozen=True, slots=True)
class Ping:
    """A robot's answer to a ping.

    Attributes:
        state: the robot's own view of its state.
        release: the release of the framework that runs it.
        stopped: the reason of an emergency stop that holds it; None if none does.
        holders: the names of the controllers that hold resources, by the resources' names.
        holder_ids: of these, the resources that this process holds, with its RobotHandle.controller_id.
        round_trip_s: the ping's round trip in real seconds; 0 for a robot of this process.
        offset_s: the robot's clock minus the controller's, both in real seconds; 0 for a robot of this process.
        offset_error_s: the greatest error of `offset_s`, either way.
        not_ready: why the devices of resources cannot be used now, by the resources' names.
        running: the running commands of all controllers.
        mailboxes: the loads of mailboxes in another process, by the resources' names, in real seconds; no empty ones.
        warnings: what needs attention before it fails, such as a certificate that expires soon.
        restarts: the restarts of resources in another process, by their names; only those over 0.
    """

    state: RobotState
    release: str
    resources: int
    stopped: str | None = None
    holders: Mapping[str, str] = field(default_factory=dict)
    holder_ids: Mapping[str, str] = field(default_factory=dict)
    round_trip_s: float = 0.0
    offset_s: float = 0.0
    offset_error_s: float = 0.0
    not_ready: Mapping[str, str] = field(default_factory=dict)
    running: tuple[RunningCommand, ...] = ()
    mailboxes: Mapping[str, MailboxLoad] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    restarts: Mapping[str, int] = field(default_factory=dict)


class RobotView:
    """The state of a robot, readable by any thread and written by its actor alone.

    Attributes:
        cells: its resources' slots by name, in the order of its plugins.
        problems: the errors of plugins that did not connect, or of the robot's failure.
        left_out: why connected plugins lack resources.
        not_ready: why resources are not ready, by their names; the resources' actors write it too.
        controller_id: the id by which a robot of another process knows this one; None for a robot of this process.
        started: done when every resource is up, or the robot has failed.
        stopped: done when everything has ended.
    """

    def __init__(self, name: str, clock: Clock) -> None:
        self.name = name
        self.clock = clock
        self._state = RobotState.STARTING
        self._lock = threading.Lock()
        self._observers: tuple[Callable[[RobotState], None], ...] = ()
        self._successor: RobotView | None = None
        self.cells: dict[str, ResourceCell] = {}
        self.problems: tuple[EALError, ...] = ()
        self.left_out: tuple[str, ...] = ()
        self.restarts: dict[str, int] = {}
        self.not_ready: dict[str, str] = {}
        self.latch = StopLatch()
        self.controller_id: str | None = None
        self.started: Future[None] = Future(clock)
        self.stopped: Future[None] = Future(REAL_TIME)

    @property
    def state(self) -> RobotState:
        """The robot's state."""
        return self._state

    @state.setter
    def state(self, state: RobotState) -> None:
        with self._lock:
            if state is self._state:
                return
            self._state = state
            observers = self._observers
        for observer in observers:
            self._notify(observer, state)

    def observe(self, observer: Callable[[RobotState], None]) -> Callable[[], None]:
        """Call an observer with the state now and at each change; return a function that stops it.

        Errors of the observer are logged. Thread: any; the observer runs in this thread once, then in the robot's.
        """
        with self._lock:
            self._observers = (*self._observers, observer)
            state = self._state
        self._notify(observer, state)
        return lambda: self._remove(observer)

    def _remove(self, observer: Callable[[RobotState], None]) -> None:
        with self._lock:
            self._observers = tuple(other for other in self._observers if other is not observer)
            successor = self._successor
        if successor is not None:
            successor._remove(observer)

    def inherit(self, former: RobotView) -> None:
        """Take over the observers and the emergency stop of the robot's former connection, which has ended."""
        if (reason := former.latch.reason) is not None:
            self.latch.set(reason)
        with former._lock:
            former._successor, observers = self, former._observers
        for observer in observers:
            self.observe(observer)

    def _notify(self, observer: Callable[[RobotState], None], state: RobotState) -> None:
        try:
            observer(state)
        except (KeyboardInterrupt, AbandonedThread):  # they are meant for this thread
            raise
        except BaseException:  # noqa: BLE001  # user code must not break the robot's thread
            get_logger(robot=self.name).exception("a callback of the robot's state raised")

    def note_readiness(self, name: str, reason: str | None) -> None:
        """Record why a resource is not ready; None if it is. Log it. Thread: any."""
        with self._lock:
            before = self.not_ready.pop(name, None)
            is_known = reason in self.not_ready.values()  # a port has many resources: it is logged once
            if reason is not None:
                self.not_ready[name] = reason
        log = get_logger(robot=self.name, resource=name)
        if reason is None and before is not None:
            log.info("ready again")
        elif reason is not None and before is None and not is_known:
            log.warning("not ready", reason=reason)


class StateFuture(Future[RobotState]):
    """Done when a robot is in a state. It fails at the deadline, or as soon as the robot can never reach the state.

    `timeout_s` is in seconds of the fleet's clock.
    """

    def __init__(self, view: RobotView, state: RobotState, timeout_s: float, timekeeper: Timekeeper) -> None:
        if timeout_s != timeout_s:  # NaN: it would never fail
            raise ArgumentError(f"timeout_s must be seconds, not {timeout_s!r}", robot=view.name)
        super().__init__(view.clock, view.clock.now() + timeout_s, timekeeper)
        self._view = view
        self._wanted = state
        self._timeout_s = timeout_s
        stop_observing = view.observe(self._check)
        self.link(lambda _, __: stop_observing())
        self.arm()  # otherwise a future that nobody waits for would observe the robot for ever

    @override
    def describe(self) -> str:
        return f"{self._view.name}: wait for state {self._wanted.value}"

    def _check(self, state: RobotState) -> None:
        if state is self._wanted:
            self.set(state)
        elif state is RobotState.STOPPED or (state is RobotState.FAILED and self._wanted is not RobotState.STOPPED):
            why = f"it is {state.value}, and cannot become {self._wanted.value} any more"
            self.set_exception(UnavailableError(why, robot=self._view.name))

    @override
    def _deadline_error(self) -> EALError:
        state = self._view.state.value
        message = f"still {state}, not {self._wanted.value}, after {self._timeout_s:g} s"
        return DeadlineError(message, robot=self._view.name)


class RobotConnection(Protocol):
    """The actor behind a robot: one that runs it in this process, or one that reaches it over a network.

    `actor_inbox` runs the timers of deadlines, by the fleet's clock. Thread: any; only `join` blocks.
    """

    clock: Clock
    is_remote: bool
    actor_inbox: Inbox

    def running(self) -> tuple[RunningCommand, ...]:
        """Return the running commands, as far as is known now."""

    def ping(self) -> Future[Ping]:
        """Ask for the robot's state and the offset of its clock."""

    def stop_now(self, reason: str) -> Future[None]:
        """Latch the emergency stop: halt everything that moves and refuse motions."""

    def resume(self) -> Future[None]:
        """Release the emergency stop."""

    def release(self, resources: Sequence[str], /) -> Future[None]:
        """Release resources that this process holds, so that other controllers may command them."""

    def halt_before_end(self) -> None:
        """Halt everything that moves; `shut_down` follows, but other robots may have their turn before."""

    def shut_down(self) -> None:
        """Stop every resource safely, and end. The second time it has no effect."""

    def force_down(self) -> None:
        """Abandon every resource that has not stopped by itself."""

    def abandon(self, error: EALError) -> None:
        """Abandon a stuck actor."""

    def is_at_work(self) -> bool:
        """Return whether the caller runs in a thread of this robot, which cannot wait for its own end."""

    def join(self, timeout_s: float) -> list[str]:
        """Wait (real time) for its threads; return the names of those still alive. Thread: blocks the caller."""
