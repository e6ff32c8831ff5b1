"""Host: what the robot servers of one session share, so that a process may serve very many robots."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, Protocol, Self

from eal_actors.actors.actor import EALActor
from eal_actors.clock import REAL_TIME
from eal_actors.errors import EALError, ProtocolError, shown
from eal_actors.log import get_logger
from eal_actors.net import keys
from eal_actors.net.outbox import Outbox
from eal_actors.net.wire import decode_heartbeat

if TYPE_CHECKING:
    import zenoh

_LOOK_EACH_S: Final = (0.02, 0.25)


class Served(Protocol):
    """A robot server, as its host sees it."""

    def look(self) -> None:
        """See after silent controllers, long commands and the robot's state. Thread: the host's; does not block."""
        ...

    def hear(self, client: str, name: str) -> None:
        """Take in a controller's sign of life, and what it calls itself. Thread: zenoh's; does not block."""
        ...

    def forsake(self) -> None:
        """Halt the robot: nobody looks after it any more. Thread: the host's."""
        ...


class Host(EALActor):
    """Looks after the robot servers of a session, hears heartbeats for all of them, and has an outbox for all.

    Args:
        fleet: the fleet's name.
        session: an open session, which outlives the host.
        dead_man_s: the dead-man's time, which says how often to look.
        name: of its threads.

    Attributes:
        outbox: sends what the servers have to say.

    Thread: an actor, which never waits for a link: halts for the sake of a silent controller are in time.
    """

    def __init__(self, fleet: str, session: zenoh.Session, dead_man_s: float, name: str = "") -> None:
        super().__init__(f"{name or fleet} server", REAL_TIME)
        least_s, most_s = _LOOK_EACH_S
        self._period_s = min(max(dead_man_s / 10, least_s), most_s)
        self._fleet = fleet
        self._session = session
        self._lock = threading.Lock()
        self._servers: tuple[Served, ...] = ()
        self._heartbeats: zenoh.Subscriber[None] | None = None
        self.outbox = Outbox(f"{name or fleet} outbox", session)

    def launch(self) -> Self:
        """Start; see EALActor."""
        self.outbox.launch()
        return super().launch()

    def on_start(self) -> None:
        """Listen for heartbeats, and begin to look after the servers. Thread: the actor's own."""
        import zenoh

        self._heartbeats = self._session.declare_subscriber(
            keys.heartbeat_keys(self._fleet), zenoh.handlers.Callback(self._on_heartbeat, indirect=False)
        )
        self._look()

    def add(self, server: Served) -> None:
        """Look after a server from now on. Thread: any."""
        with self._lock:
            self._servers = (*self._servers, server)

    def remove(self, server: Served) -> None:
        """Look after it no more. Thread: any."""
        with self._lock:
            self._servers = tuple(other for other in self._servers if other is not server)

    def soon(self, action: Callable[[], None]) -> None:
        """Run an action in the host's thread, unless it has ended. Thread: any; does not block."""
        try:
            self.actor_inbox.call_soon(action)
        except EALError:
            get_logger(fleet=self._fleet).debug("the server has ended; something came too late")

    def close(self, timeout_s: float) -> None:
        """Send what waits, and end. Thread: blocks the caller."""
        end_s = REAL_TIME.now() + timeout_s
        self.end_soon()
        for actor in (self, self.outbox):
            if actor.thread is not None:
                actor.thread.join(max(0.0, end_s - REAL_TIME.now()))
                if actor.thread.is_alive():
                    get_logger(fleet=self._fleet).error(
                        "a thread did not end in time and was left behind", name=actor.name
                    )

    def on_stop(self) -> None:
        """Hear nobody any more. Thread: the actor's own."""
        if self._heartbeats is not None:
            self._heartbeats.undeclare()  # type: ignore[no-untyped-call]  # zenoh's stubs say nothing of it
        self.outbox.end_soon()

    def on_crash(self, error: BaseException) -> None:
        """Halt the robots, which nobody watches any more. Thread: the actor's own."""
        get_logger(fleet=self._fleet).error("the server has crashed; its robots are halted", error=shown(error))
        for server in self._servers:
            server.forsake()
        self.on_stop()

    def _look(self) -> None:
        for server in self._servers:
            server.look()
        self.actor_inbox.call_later(self._period_s, self._look)

    def _on_heartbeat(self, sample: zenoh.Sample) -> None:
        """Thread: zenoh's."""
        try:
            beat = decode_heartbeat(sample.payload.to_bytes())
        except ProtocolError as error:
            get_logger(fleet=self._fleet).warning("a heartbeat makes no sense", reason=error.message)
            return
        for server in self._servers:
            server.hear(beat.client, beat.name)
