"""Controller: a fleet's network in this process: one session, the robots' liveliness tokens, and the heartbeat.

The heartbeat must not depend on the program: robots halt when it stays away. So this thread sends it four times within
the dead-man's time, and sends no calls and runs no callbacks of the program. While the session is opened again, all
robots count as lost.
"""

from __future__ import annotations

import math
import secrets
import threading
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from typing import TYPE_CHECKING, Final, NamedTuple, Self

from typing_extensions import override

from eal_actors.actors.actor import EALActor
from eal_actors.actors.inbox import Inbox
from eal_actors.actors.robot_view import process_name
from eal_actors.device.data import Payload
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import EALError, ProtocolError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.throttled_log import ThrottledLog
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.keys.expiry import certificate_warnings
from eal_actors.managers.keys.key_watch import WATCH_PERIOD_S, KeyWatch
from eal_actors.wire.format import keys, parts
from eal_actors.wire.format.batches import BEGINS_BATCH, decode_batch
from eal_actors.wire.format.messages import Heartbeat, RobotEvent, decode_event, encode_heartbeat
from eal_actors.wire.format.packing import PROTOCOL_VERSION
from eal_actors.wire.local_link import LocalLinks
from eal_actors.wire.rpc.client.call_sender import CallSender
from eal_actors.wire.rpc.client.discovery import ForeignRobots
from eal_actors.wire.rpc.sender import Send, Sender
from eal_actors.wire.security.access import Rights
from eal_actors.wire.session import controller_config, open_session
from eal_actors.wire.transport import Transport

if TYPE_CHECKING:
    import zenoh

_BYPASS_S: Final = 0.02
"""Real seconds that an urgent message may wait for another one's link before its robot's own thread sends it."""

_BEATS: Final = 4
"""Heartbeats within the dead-man's time."""

_TICK_S: Final = 0.25
"""Real seconds between two checks for calls whose time is over."""


class RobotListener(NamedTuple):
    """Callbacks of a connection to one robot, in the readers' threads except `on_tick`; none blocks.

    Attributes:
        on_alive: its liveliness token appeared; called with its protocol version.
        on_gone: its token disappeared; called with the reason.
        on_lost: the local link has ended that its calls were on.
        on_reply: a reply arrived; called with its envelope and its payload.
        on_event: an event arrived; raises ProtocolError if that is malformed.
        on_tick: called every 0.25 s with the real time. Thread: the controller's.
    """

    name: str
    on_alive: Callable[[int], None]
    on_gone: Callable[[str], None]
    on_lost: Callable[[], None]
    on_reply: Callable[[bytes, bytes], None]
    on_event: Callable[[RobotEvent], None]
    on_tick: Callable[[float], None]


class Controller(EALActor):
    """Network of one fleet in this process; ConfigError if its keys are missing.

    Attributes:
        client: identifier of this controller, new in each process; see keys.client_id.
        certificate: name of its certificate; None in a fleet without security.
        display_name: its name for people, which robots show.
        dead_man_s: real seconds of its silence after which a robot halts what it moves.
        foreign: the robots of other fleets that answer, in a fleet without security.
        shares_memory: whether it shares memory with robots on this machine: not once the system has refused that.
        last_handshake_s: real time of the last handshake that a robot has answered.

    Thread: an actor, which opens the session and sends the heartbeat. The readers' threads run the listeners'
    callbacks.
    """

    def __init__(self, config: FleetConfig, clock: Clock, robots: Iterable[str] | None = None) -> None:
        super().__init__(f"{config.name} network", clock)
        self.fleet: Final = config.network_name
        self._secret: Final = secrets.token_hex(16)
        security = config.network.security
        self.certificate: Final = None if security is None else security.controller
        self._caller = self.certificate or keys.ANYBODY
        self.client: Final = keys.client_id(self._caller, self._secret)
        self.dead_man_s: Final = config.network.dead_man_s
        self.shares_memory = config.network.shared_memory
        self.display_name: Final = process_name(self.certificate)
        self._config = config
        self._robots = None if robots is None else tuple(robots)
        self._keys = KeyWatch(None if security is None else security.keys, self._caller)
        self._network = controller_config(config, self._robots)
        self._lock = threading.Lock()
        self._malformed = ThrottledLog(fleet=config.name)
        self._listeners: dict[str, RobotListener] = {}
        self.foreign: Final = ForeignRobots()
        self.last_handshake_s = -math.inf
        self._versions: dict[str, int] = {}  # protocol versions of the live robots
        self._transport: Transport | None = None
        self._stack = ExitStack()
        self._is_ending = False
        self.sender: Final = CallSender(f"{config.name} sender", self.put, self.is_alive)
        self._urgent_sender = Sender(f"{config.name} urgent sender")
        self._callbacks = EALActor(f"{config.name} callbacks", clock)
        self._helpers = self.sender, self._urgent_sender, self._callbacks
        self.local: Final = LocalLinks(
            self._on_reply, self._on_local_loss, is_on=config.network.shared_memory and security is None
        )

    def warnings(self) -> list[str]:
        """Return warnings about certificates of this process that expire soon. Thread: any."""
        return certificate_warnings(self._config.network.security, self._caller)

    def give_up_sharing(self, error: OSError) -> None:
        """Log once that values come over the link. Thread: any."""
        if self.shares_memory:
            self.shares_memory = False
            message = "no shared memory; large values of robots on this machine come over their links"
            get_logger(fleet=self.fleet).warning(message, reason=error_text(error))

    # Life.

    @override
    def launch(self) -> Self:
        for helper in self._helpers:
            helper.launch()
        return super().launch()

    @property
    def timekeeper(self) -> Inbox:
        """Mailbox with the timers of all robots' deadlines, so that calls to many robots share one alarm."""
        return self._callbacks.actor_inbox

    def send_urgently(self, send: Send, bypass: Callable[[], None]) -> None:
        """Send a message before all queued ones, even while a link is stalled. Thread: any; does not block.

        `bypass` has it sent by another thread, unless it was sent by then.
        """
        self._urgent_sender.submit(send)
        self.timekeeper.call_later(self.clock.of_real(_BYPASS_S), bypass)

    def run_later(self, action: Callable[[], None]) -> None:
        """Run callbacks of a reply outside the readers' threads. Thread: any; does not block."""
        try:
            self._callbacks.actor_inbox.call_soon(action)
        except EALError:  # the network is closed, so no thread is blocked
            action()

    @override
    def on_start(self) -> None:
        self._open()
        self._beat()
        self._tick()
        if self._keys:
            self._follow_keys()

    def _open(self) -> None:
        """Open the session; may take seconds if a router does not answer."""
        try:
            opening = open_session(self._network, is_wanted=lambda: not self._is_ending)
            session = self._stack.enter_context(opening)
        except EALError as error:
            if self._is_ending:
                return
            get_logger(fleet=self.fleet).error("the network cannot be opened", reason=error.message)
            self._lose_robots(f"cannot be reached: {error.message}")
            self.actor_inbox.call_later(self.clock.of_real(1.0), self._open)
            return
        self._transport = transport = Transport(session)
        answers = keys.answer_key(self.fleet, self._caller, self._secret, None)
        transport.receive(answers, f"{self.fleet} answers", self._on_answer)
        transport.receive(keys.event_key(self.fleet, None), f"{self.fleet} events", self._on_event)
        tokens = keys.ALL_ALIVE if self.certificate is None else keys.alive_key(self.fleet, None)
        transport.receive_tokens(tokens, f"{self.fleet} presence", self._on_liveliness)
        self._send_heartbeat(transport)

    def _follow_keys(self) -> None:
        if self._keys.has_changed():
            self._keys.accept()
            self._use_changed_keys()
        self.actor_inbox.call_later(self.clock.of_real(WATCH_PERIOD_S), self._follow_keys)

    def _use_changed_keys(self) -> None:
        """Open the session again with a renewed certificate or a longer list of revoked names; commands continue."""
        log = get_logger(fleet=self.fleet)
        try:
            self._network = controller_config(self._config, self._robots)
        except EALError as error:
            log.error("the changed keys cannot be used; the former ones stay in use", reason=error.message)
            return
        if self._transport is None:  # it is being opened, with the changed keys from now on
            return
        self._transport = None
        self._stack.close()
        with self._lock:
            self._versions.clear()
        self._lose_robots("is disconnected: the keys have changed")
        log.info("the keys have changed: the network is opened again")
        self._open()

    def _lose_robots(self, reason: str) -> None:
        for listener in list(self._listeners.values()):
            listener.on_gone(reason)

    def _beat(self) -> None:
        if self._transport is not None:
            self._send_heartbeat(self._transport)
        period_s = self.dead_man_s / _BEATS
        self.actor_inbox.call_later(self.clock.of_real(period_s), self._beat)

    def _send_heartbeat(self, transport: Transport) -> None:
        key = keys.heartbeat_key(self.fleet, self._caller, self._secret)
        beat = encode_heartbeat(Heartbeat(self.client, self.display_name))
        transport.put(key, None, beat, is_urgent=True, is_vital=False)

    def _tick(self) -> None:
        now_s = REAL_TIME.now()
        for listener in list(self._listeners.values()):
            listener.on_tick(now_s)
        self.actor_inbox.call_later(self.clock.of_real(_TICK_S), self._tick)

    def shut_down(self) -> None:
        """Close the session, and end. Thread: any; does not block."""
        self._is_ending = True
        self.end_soon()

    @override
    def on_stop(self) -> None:
        self._transport = None
        self.local.close()
        for helper in self._helpers:
            helper.end_soon()
        self._stack.close()

    @override
    def on_crash(self, error: BaseException) -> None:
        get_logger(fleet=self.fleet).error("the network has crashed", error=error_text(error))
        self.on_stop()

    def join(self, timeout_s: float) -> bool:
        """Wait (real time) for its end; return whether all its threads ended. Thread: blocks the caller."""
        end_s = REAL_TIME.now() + timeout_s
        threads = [actor.thread for actor in (self, *self._helpers) if actor.thread is not None]
        with self.clock.outside():
            for thread in threads:
                thread.join(max(0.0, end_s - REAL_TIME.now()))
        return not any(thread.is_alive() for thread in threads)

    # Robots. Thread: any.

    def add(self, listener: RobotListener) -> None:
        """Add the listener of a robot; it is called at once if the robot is alive."""
        with self._lock:
            self._listeners[listener.name] = listener
            version = self._versions.get(listener.name)
        if version is not None:
            listener.on_alive(version)

    def remove(self, listener: RobotListener) -> None:
        """Remove a listener; ignored if another one has replaced it."""
        with self._lock:
            if self._listeners.get(listener.name) is listener:
                del self._listeners[listener.name]
                self.local.disconnect(listener.name)

    def why_silent(self, robot: str, address: str) -> str:
        """Return why nothing has come from a robot at an address."""
        if self._transport is None and self._network["mode"] == "client":
            return f"cannot be reached: no router answers at {', '.join(self._network['connect']['endpoints'])}"
        others = self.foreign.describe()
        what = f"; robots of another fleet do, which only its own file commands: {others}" if others else ""
        return f"does not answer at {address}{what}{self._why_refused(robot)}"

    def _why_refused(self, robot: str) -> str:
        """Return why a robot does not accept this program, as the end of a reason; nothing if that is unknown."""
        security = self._config.network.security
        wrong = certificate_warnings(security, self._caller, only_invalid=True)
        if security is not None and Rights.by_file(security, robot).denied(keys.ROBOT, keys.HELLO) is not None:
            wrong.append(f"the fleet file gives the certificate {self._caller} no role there")
        return "".join(f"; {warning}" for warning in wrong)

    def is_alive(self, robot: str) -> bool:
        """Return whether the robot's liveliness token is there, with our protocol version."""
        return self._versions.get(robot) == PROTOCOL_VERSION

    def subscribe(self, key: str, on_sample: Callable[[str, zenoh.Sample], None]) -> Callable[[], None] | None:
        """Subscribe to a key, in a thread; return a function that ends it, or None if the network is not open."""
        import zenoh

        transport = self._transport
        try:
            return None if transport is None else transport.receive_samples(key, f"{self.fleet} stream", on_sample)
        except zenoh.ZError as error:
            get_logger(fleet=self.fleet).debug("a subscription failed", key=key, reason=error_text(error))
            return None

    def call_key(self, robot: str, resource: str, method: str) -> str:
        """Return the key of this controller's calls of a method."""
        return keys.call_key(keys.CallKey(self.fleet, robot, resource, method, self._caller, self._secret))

    def put(
        self, robot: str, key: str, envelope: bytes, payload: Payload, *, is_urgent: bool = False, is_last: bool = True
    ) -> bool:
        """Send a call to a robot; return False if the robot is unreachable, so that no reply will arrive.

        The flags and the thread are those of Transport.put.
        """
        transport = self._transport
        if transport is None:
            return False
        if (is_local := self.local.put(robot, key, envelope, payload, is_urgent=is_urgent)) is not None:
            is_sent = is_local
        elif len(envelope) + len(payload) <= parts.PART_BYTES:
            is_sent = transport.put(key, envelope, payload, is_urgent=is_urgent, is_last=is_last)
        else:
            split = parts.split(envelope, payload)
            is_sent = all(transport.put(key, *part, is_urgent=is_urgent, is_last=is_last) for part in split)
        return is_sent and self._versions.get(robot) == PROTOCOL_VERSION  # it may have gone before the call was pending

    # Messages, in the readers' threads.

    def _on_liveliness(self, key: str, is_alive: bool) -> None:
        try:
            fleet, name, version = keys.parse_alive(key)
        except ProtocolError:
            return
        if fleet != self.fleet:
            self.foreign.note(fleet, name, is_alive=is_alive)
            return
        with self._lock:
            listener = self._listeners.get(name)
            was_alive = self._versions.get(name) == version
            if is_alive:
                self._versions[name] = version
            elif was_alive:
                del self._versions[name]
        if is_alive != was_alive:  # the engine may report a token twice
            self.local.disconnect(name)
        elif not is_alive:  # the robot was updated, and its old token disappears after the new one appeared
            return
        if listener is not None and is_alive:
            listener.on_alive(version)
        elif listener is not None:
            listener.on_gone(f"is unreachable{self._why_refused(name)}")

    def _on_reply(self, robot: str, envelope: bytes, payload: bytes) -> None:
        if (listener := self._listeners.get(robot)) is not None:
            listener.on_reply(envelope, payload)

    def _on_local_loss(self, robot: str) -> None:
        if (listener := self._listeners.get(robot)) is not None:
            listener.on_lost()

    def _on_answer(self, key: str, envelope: bytes, payload: bytes) -> None:
        try:
            _, name = keys.parse_robot(key)
        except ProtocolError:
            return
        if envelope[:1] != BEGINS_BATCH:
            self._on_reply(name, envelope, payload)
            return
        try:
            rows = decode_batch(envelope, 1)
        except ProtocolError as error:
            self._malformed.warn(name, "a batch of replies is malformed", error.message)
            return
        for robot, *reply in rows:
            if robot == name or self.certificate is None:  # access control has proven the robot of the key only
                self._on_reply(robot, *reply)

    def _on_event(self, key: str, envelope: bytes, payload: bytes) -> None:
        try:
            _, name = keys.parse_robot(key)
            event = decode_event(envelope, payload)
            if (listener := self._listeners.get(name)) is not None:
                listener.on_event(event)
        except ProtocolError as error:
            self._malformed.warn(key.rpartition("/")[2], "an event is malformed", error.message)
