"""Host: what the robot servers of one session share, so that a process may serve very many robots."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, Protocol, Self

from eal_actors.actors.actor import EALActor
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError, ProtocolError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.net import keys
from eal_actors.net.keys import CallKey
from eal_actors.net.outbox import Outbox
from eal_actors.net.wire import decode_heartbeat

if TYPE_CHECKING:
    import zenoh

_LOOK_EACH_S: Final = (0.02, 0.25)


class Served(Protocol):
    """A robot server, as its host sees it."""

    def take(self, call: CallKey, envelope: bytes, payload: bytes) -> None:
        """Take in a call. Thread: zenoh's; does not block."""
        ...

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
    """Looks after the robot servers of a session, hears calls and heartbeats, and has an outbox for all.

    Args:
        fleet: the fleet's name.
        session: an open session, which outlives the host.
        dead_man_s: the dead-man's time, which says how often to look.
        robot: the name of the one robot that it is for; None where it may be for any of the fleet.

    Attributes:
        outbox: sends what the servers have to say.

    Thread: an actor, which never waits for a link: halts for the sake of a silent controller are in time.
    """

    def __init__(self, fleet: str, session: zenoh.Session, dead_man_s: float, robot: str | None = None) -> None:
        super().__init__(f"{robot or fleet} server", REAL_TIME)
        least_s, most_s = _LOOK_EACH_S
        self._period_s = min(max(dead_man_s / 10, least_s), most_s)
        self._fleet = fleet
        self._robot = robot
        self._session = session
        self._lock = threading.Lock()
        self._servers: dict[str, Served] = {}
        self._nonsense = ""
        self._subscribers: list[zenoh.Subscriber[None]] = []
        self.outbox = Outbox(f"{robot or fleet} outbox", session)

    def launch(self) -> Self:
        """Start, and listen: a robot that shows that it is there can be called. Thread: blocks it for a moment."""
        import zenoh

        self.outbox.launch()
        for key, take in (
            (keys.call_keys(self._fleet, self._robot), self._on_call),
            (keys.heartbeat_keys(self._fleet), self._on_heartbeat),
        ):
            callback = zenoh.handlers.Callback(take, indirect=False)
            self._subscribers.append(self._session.declare_subscriber(key, callback))
        return super().launch()

    def on_start(self) -> None:
        """Begin to look after the servers. Thread: the actor's own."""
        self._look()

    def add(self, robot: str, server: Served) -> None:
        """Look after the server of a robot from now on. Thread: any."""
        with self._lock:
            self._servers = {**self._servers, robot: server}

    def remove(self, robot: str) -> None:
        """Look after it no more. Thread: any."""
        with self._lock:
            self._servers = {name: server for name, server in self._servers.items() if name != robot}

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
        for subscriber in self._subscribers:
            subscriber.undeclare()  # type: ignore[no-untyped-call]  # zenoh's stubs say nothing of it
        self.outbox.end_soon()

    def on_crash(self, error: BaseException) -> None:
        """Halt the robots, which nobody watches any more. Thread: the actor's own."""
        get_logger(fleet=self._fleet).error("the server has crashed; its robots are halted", error=error_text(error))
        for server in self._servers.values():
            server.forsake()
        self.on_stop()

    def _look(self) -> None:
        for server in self._servers.values():
            server.look()
        self.actor_inbox.call_later(self._period_s, self._look)

    def _on_call(self, sample: zenoh.Sample) -> None:
        """Thread: zenoh's."""
        try:
            call = keys.parse_call(str(sample.key_expr))
        except ProtocolError as error:
            get_logger(fleet=self._fleet).warning("a call makes no sense", reason=error.message)
            return
        server = self._servers.get(call.robot)
        if server is not None:  # else it is for a robot that another process serves
            attachment = sample.attachment
            server.take(call, attachment.to_bytes() if attachment is not None else b"", sample.payload.to_bytes())

    def _on_heartbeat(self, sample: zenoh.Sample) -> None:
        """Thread: zenoh's."""
        try:
            beat = decode_heartbeat(sample.payload.to_bytes())
        except ProtocolError as error:
            if error.message != self._nonsense:  # it comes again and again
                self._nonsense = error.message
                get_logger(fleet=self._fleet).warning("heartbeats make no sense", reason=error.message)
            return
        for server in self._servers.values():
            server.hear(beat.client, beat.name)
