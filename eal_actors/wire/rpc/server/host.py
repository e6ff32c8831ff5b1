"""RobotHost: serves any number of robots over one session, with one thread for all.

That thread runs the dead-man's switches, so it waits for no link and no controller. The readers' threads take in calls
and heartbeats, the outbox's thread sends, and calls of the robots themselves come behind the timers that are due.
The host subscribes before a robot announces itself, so a robot that is found can be called. The mapping of its servers
is replaced and never changed, so the readers' threads use it without a lock.
"""

from __future__ import annotations

import contextlib
import secrets
import threading
from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Self

from typing_extensions import override

from eal_actors.actors.actor import EALActor
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.inbox import Action
from eal_actors.device.data import Payload
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import BusyError, DataError, EALError, ProtocolError, UnsupportedError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.throttled_log import ThrottledLog
from eal_actors.managers.keys.revocation import revoke, revoked_names
from eal_actors.managers.network_model import NetworkConfig
from eal_actors.wire.format import keys
from eal_actors.wire.format.batches import BEGINS_BATCH, decode_batch
from eal_actors.wire.format.messages import decode_heartbeat
from eal_actors.wire.format.parts import BEGINS_PART, PartStore, number_of
from eal_actors.wire.local_link import LocalLink, LocalListener
from eal_actors.wire.rpc.server.outbox import Outbox, ReplyBatch
from eal_actors.wire.rpc.server.request_handler import HostServices, RequestQueue, require_handshake
from eal_actors.wire.rpc.server.robot_server import RobotServer
from eal_actors.wire.session import links_of
from eal_actors.wire.transport import Transport

if TYPE_CHECKING:
    import zenoh

_TICK_RANGE_S: Final = (0.02, 0.25)


class RobotHost(EALActor):
    """Receives the calls and heartbeats of a session's robots, runs their timers and owns their outbox.

    It subscribes to the calls of all robots of the fleet, unless `robot` is the only one. The network's dead-man's time
    determines the period of the timer. The session is open and outlives the host. Thread: an actor.
    """

    def __init__(self, fleet: str, session: zenoh.Session, network: NetworkConfig, robot: str | None = None) -> None:
        super().__init__(f"{robot or fleet} server", REAL_TIME)
        least_s, most_s = _TICK_RANGE_S
        self._period_s = min(max(network.dead_man_s / 10, least_s), most_s)
        self._fleet = fleet
        self._robot = robot
        self._network = network
        self._is_open = network.security is None
        self._lock = threading.Lock()
        self._servers: dict[str, RobotServer] = {}
        self._malformed = ThrottledLog(fleet=fleet)
        self._parts = PartStore()
        self._parts_lock = threading.Lock()
        self._unsubscribe: list[Callable[[], None]] = []
        self._revoked = self._read_revoked()
        self._outbox = Outbox(f"{robot or fleet} outbox", Transport(session))
        requests = RequestQueue(self._run_after_timers)
        self._services = HostServices(
            fleet, network, self._outbox, secrets.token_hex(8), requests, self._revoke, self._remove
        )
        self._local: LocalListener | None = None

    def _read_revoked(self) -> frozenset[str]:
        security = self._network.security
        return frozenset() if security is None else revoked_names(security.keys)

    @override
    def launch(self) -> Self:
        self._outbox.launch()
        self._subscribe()
        if self._network.shared_memory and self._network.security is None:
            with contextlib.suppress(OSError):  # then all calls come over the engine
                self._local = LocalListener(self._services.process, self._has_link_at, self._receive)
        return super().launch()

    def _subscribe(self) -> None:
        calls = keys.call_keys(self._fleet, self._robot)
        beats = keys.heartbeat_key(self._fleet, None, None)
        transport = self._outbox.transport
        self._unsubscribe = [  # before any token: a robot that is found can be called
            transport.receive(calls, f"{self.name} calls", partial(self._receive, None)),
            transport.receive(beats, f"{self.name} heartbeats", self._on_heartbeat),
        ]
        if transport.is_relayed:
            servers = keys.server_key(self._fleet, self._robot, None, None)
            self._unsubscribe.append(transport.receive_tokens(servers, f"{self.name} servers", self._on_server))

    def move_to(self, session: zenoh.Session) -> None:
        """Continue on another session, after the earlier one was closed. Thread: blocks the caller for a moment."""
        self._revoked = self._read_revoked()
        self._outbox.transport = Transport(session)
        for server in self._servers.values():
            server.tokens.forget()
        self._subscribe()
        for server in self._servers.values():
            server.tokens.renew()

    def _on_server(self, key: str, is_alive: bool) -> None:
        """Note that another process serves a robot of this one. Thread: a reader's; does not block."""
        robot, process, name = keys.parse_server(key)
        if (server := self._servers.get(robot)) is not None:
            server.tokens.note(process, name, is_alive=is_alive)

    def serve(self, robot: RobotHandle, exclusive: Iterable[str] | None = None) -> RobotServer:
        """Serve a started robot of this process until its server is closed. Thread: blocks the caller for a moment.

        `exclusive` are the resources that one controller at a time may command; every actuator if None. Raises
        DataError if the robot has too many resources for a handshake, and UnavailableError if another process serves it
        behind the same router.
        """
        try:
            require_handshake([handle.info for handle in robot.values()])
        except DataError as error:
            raise error.at(robot.name) from None
        server = RobotServer(self._services, robot, exclusive)
        server.tokens.claim()  # before any call reaches it
        with self._lock:
            self._servers = {**self._servers, robot.name: server}
        server.tokens.announce()
        return server

    def _revoke(self, names: Iterable[str]) -> None:
        """Disconnect controllers whose certificates are revoked, and store their names; see `revoke`.

        From here on their messages are ignored. The session's keeper sees the stored list and ends their links. Raises
        ConfigError if the names cannot be stored, and UnsupportedError if the fleet has no security.
        """
        security = self._network.security
        if security is None:
            raise UnsupportedError("the fleet has no certificates: network.security is not set")
        names = frozenset(names)
        new, self._revoked = names - self._revoked, self._revoked | names
        for server in self._servers.values():
            for name in sorted(new):
                server.expel(name)
        revoke(security.keys, names)

    def _remove(self, robot: str) -> None:
        with self._lock:
            self._servers = {name: server for name, server in self._servers.items() if name != robot}

    def _run_after_timers(self, action: Callable[[], None]) -> None:
        """Run an action in the host's thread unless the host has ended. Thread: any; does not block."""
        try:
            self.actor_inbox.put(Action(0.0, 0, action))
        except EALError:
            get_logger(fleet=self._fleet).debug("the server has ended; an action is discarded")

    def close(self, timeout_s: float) -> None:
        """Send the queued messages and end. Thread: blocks the caller."""
        end_s = REAL_TIME.now() + timeout_s
        self.end_soon()
        for actor in (self, self._outbox, self._outbox.urgent):
            if actor.thread is not None:
                actor.thread.join(max(0.0, end_s - REAL_TIME.now()))
                if actor.thread.is_alive():
                    get_logger(fleet=self._fleet).error(
                        "a thread did not end in time and was left behind", name=actor.name
                    )

    @override
    def on_start(self) -> None:
        self._tick()

    @override
    def on_stop(self) -> None:
        for unsubscribe in self._unsubscribe:
            unsubscribe()
        if self._local is not None:
            self._local.close()
        self._outbox.end_soon()

    @override
    def on_crash(self, error: BaseException) -> None:
        get_logger(fleet=self._fleet).error("the server has crashed; its robots are halted", error=error_text(error))
        for server in self._servers.values():
            server.fail()
        self.on_stop()

    def _tick(self) -> None:
        for server in self._servers.values():
            server.tick()
        self.actor_inbox.call_later(self._period_s, self._tick)

    # Messages, in the readers' threads.

    def _has_link_at(self, port: int) -> bool:
        return any(link.port == port for link in links_of(self._outbox.transport.session))

    def _receive(self, link: LocalLink | None, key: str, envelope: bytes, payload: Payload) -> None:
        """Serve a call, of a local link if one is given.

        Ignored are callers whose certificate is revoked, and those that claim one in a fleet without security, where
        nothing bounds such names, and much is bounded for each of them.
        """
        try:
            route = keys.parse_route(key)
            caller, first = route.call.caller, envelope[:1]
            if caller in self._revoked or (self._is_open and caller != keys.ANYBODY):
                return
            server = self._servers.get(route.call.robot)
            if first == BEGINS_PART:
                if server is None:
                    return
                with self._parts_lock:
                    whole = self._parts.add(key, envelope, payload)
                if whole is None:
                    return
                envelope, payload = whole
                first = envelope[:1]
            if first == BEGINS_BATCH:
                self._receive_batch(key, route, decode_batch(envelope, 3))
                return
        except ProtocolError as error:
            self._malformed.warn(keys.sender_of(key), "a call is malformed", error.message)
            return
        except BusyError as error:
            if server is not None:
                server.refuse(route, number_of(envelope), error)
            return
        if server is not None:  # else another process serves the robot
            server.receive(route, envelope, payload, None, link)

    def _receive_batch(self, key: str, route: keys.CallRoute, rows: list[list[Any]]) -> None:
        """Serve the calls of a batch in their order; ProtocolError, and nothing is served, if one has a wrong place."""
        routes = [keys.route_in_batch(key, *row[:3]) for row in rows]
        if self._network.security is not None and any(other.call != route.call for other in routes):
            raise ProtocolError("a batch has calls that access control has not checked")
        batch = ReplyBatch(self._outbox, route.answer_key)
        for other, (*_, envelope, payload) in zip(routes, rows, strict=True):
            server = self._servers.get(other.call.robot)
            if server is not None:
                server.receive(other, envelope, payload, batch)

    def _on_heartbeat(self, key: str, _: bytes, payload: bytes) -> None:
        try:
            caller, client = keys.parse_heartbeat(key)
            beat = decode_heartbeat(payload)
            if beat.client != keys.client_id(caller, client):
                raise ProtocolError(f"a controller named {caller} sends the heartbeat of another one")
        except ProtocolError as error:
            self._malformed.warn(keys.sender_of(key), "a heartbeat is malformed", error.message)
            return
        if caller in self._revoked or (self._is_open and caller != keys.ANYBODY):  # as in _receive
            return
        for server in self._servers.values():
            server.receive_heartbeat(caller, beat)
