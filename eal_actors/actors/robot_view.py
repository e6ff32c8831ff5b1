"""What everybody may know of a robot connection, and what whoever serves one must be able to do."""

from __future__ import annotations

import enum
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from typing import Protocol

from eal_actors.actors.call import ResourceCell, StopLatch
from eal_actors.actors.future import Future
from eal_actors.actors.inbox import Inbox
from eal_actors.actors.running import Running
from eal_actors.actors.waiting import Waiting
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import EALError
from eal_actors.kernel.log import get_logger


@cache
def release() -> str:
    """Return the release of the framework."""
    return version("eal-actors")


class RobotState(enum.Enum):
    """Where a robot connection is in its life."""

    STARTING = "starting"
    READY = "ready"
    LOST = "lost"
    """It was ready, and is out of reach; it is looked for, and comes back by itself."""
    FAILED = "failed"
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True)
class Ping:
    """A robot's answer to a ping.

    Attributes:
        state: where the robot is in its life, as it says itself.
        release: the release of the framework that runs it.
        resources: how many resources it has.
        stopped: why an emergency stop holds it; None if none does.
        holders: by the names of resources, the controllers that hold them, as people call them.
        holder_ids: the same controllers by their ids; see RobotHandle.controller_id.
        round_trip_s: real seconds that this ping was under way; 0 for a robot of this process.
        offset_s: the robot's clock minus the controller's, both in real seconds; 0 for a robot of this process.
        offset_error_s: by how many seconds at most `offset_s` is wrong, either way.
        not_ready: by the names of resources whose device cannot be used now, the reason.
        running: the commands under way, whoever gave them.
        mailboxes: by the names of resources of another process, what waits there, in real seconds; without empty ones.
        restarts: how often resources of another process were restarted; without those that never were.
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
    running: tuple[Running, ...] = ()
    mailboxes: Mapping[str, Waiting] = field(default_factory=dict)
    restarts: Mapping[str, int] = field(default_factory=dict)


class RobotView:
    """What everybody may read of a robot; written by its actor alone.

    Args:
        name: the robot's name.
        clock: the fleet's clock.

    Attributes:
        cells: its resources' slots by name, in the order of its plugins.
        problems: what kept plugins out, or made the robot fail.
        restarts: how often each resource was restarted.
        not_ready: why resources are not ready, by their names; written by the resources' actors too.
        latch: whether an emergency stop holds it.
        controller_id: what a robot of another process knows us by; None in its own.
        started: done when every resource is up, or the robot has failed.
        stopped: done when everything has ended.
    """

    def __init__(self, name: str, clock: Clock) -> None:
        self.name = name
        self.clock = clock
        self._state = RobotState.STARTING
        self._lock = threading.Lock()
        self._observers: tuple[Callable[[RobotState], None], ...] = ()
        self.cells: dict[str, ResourceCell] = {}
        self.problems: tuple[EALError, ...] = ()
        self.restarts: dict[str, int] = {}
        self.not_ready: dict[str, str] = {}
        self.latch = StopLatch()
        self.controller_id: str | None = None
        self.started: Future[None] = Future(clock)
        self.stopped: Future[None] = Future(REAL_TIME)

    @property
    def state(self) -> RobotState:
        """Where it is in its life."""
        return self._state

    @state.setter
    def state(self, state: RobotState) -> None:
        with self._lock:
            if state is self._state:
                return
            self._state = state
            observers = self._observers
        for observer in observers:
            self._tell(observer, state)

    def observe(self, observer: Callable[[RobotState], None]) -> Callable[[], None]:
        """Tell of the state now, and of each change; returns what ends that. Errors of the observer are logged.

        Thread: any; the observer runs in this thread once, then in the robot's.
        """
        with self._lock:
            self._observers = (*self._observers, observer)
            state = self._state
        self._tell(observer, state)
        return lambda: self._forget(observer)

    def _forget(self, observer: Callable[[RobotState], None]) -> None:
        with self._lock:
            self._observers = tuple(other for other in self._observers if other is not observer)

    def _tell(self, observer: Callable[[RobotState], None], state: RobotState) -> None:
        try:
            observer(state)
        except (Exception, SystemExit, GeneratorExit):  # noqa: BLE001  # anybody's code must not break the robot's thread
            get_logger(robot=self.name).exception("a callback of the robot's state raised")

    def note_readiness(self, name: str, reason: str | None) -> None:
        """Note why a resource is not ready; None if it is. Thread: any."""
        if reason is None:
            self.not_ready.pop(name, None)
        else:
            self.not_ready[name] = reason


class RobotConnection(Protocol):
    """The actor behind a robot: one that runs it in this process, or one that speaks with it over a network."""

    @property
    def clock(self) -> Clock:
        """The fleet's clock."""
        ...

    @property
    def is_remote(self) -> bool:
        """Whether the robot is in another process."""
        ...

    @property
    def actor_inbox(self) -> Inbox:
        """Where deadlines are rung, by the fleet's clock."""
        ...

    def running(self) -> tuple[Running, ...]:
        """Return the commands under way, as far as is known now. Thread: any; does not block."""
        ...

    def ping(self) -> Future[Ping]:
        """Ask how the robot is, and how far its clock is from ours. Thread: any; does not block."""
        ...

    def stop_now(self, reason: str) -> Future[None]:
        """Halt whatever moves, and refuse motions from now on. Thread: any; does not block."""
        ...

    def resume(self) -> Future[None]:
        """Allow motions again. Thread: any; does not block."""
        ...

    def release(self, resources: Sequence[str], /) -> Future[None]:
        """Let others command resources that this process holds. Thread: any; does not block."""
        ...

    def shut_down(self) -> None:
        """Stop every resource safely, and end. Thread: any; does not block."""
        ...

    def force_down(self) -> None:
        """Abandon whatever has not stopped by itself. Thread: any; does not block."""
        ...

    def abandon(self, error: EALError) -> None:
        """Give up an actor that is stuck. Thread: any; does not block."""
        ...

    def is_at_work(self) -> bool:
        """Return whether the caller runs in a thread of this robot, which cannot wait for its own end."""
        ...

    def join(self, timeout_s: float) -> list[str]:
        """Wait (real time) for its threads; return the names of those still alive. Thread: blocks the caller."""
        ...
