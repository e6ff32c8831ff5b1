"""Controller: a fleet's end of the network: one session, the signs of life of its robots, and its own heartbeat."""

from __future__ import annotations

import contextlib
import secrets
import threading
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from typing import TYPE_CHECKING, Final, Self

from eal_actors.actors.actor import EALActor, Inbox
from eal_actors.actors.robot_view import process_name
from eal_actors.device.data import Payload
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import EALError, ProtocolError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.net import keys
from eal_actors.net.connection import Reached
from eal_actors.net.pacing import Pace
from eal_actors.net.packing import PROTOCOL_VERSION
from eal_actors.net.sender import Sender, UrgentMessage
from eal_actors.net.session import controller_config, open_session
from eal_actors.net.wire import Heartbeat, Reply, decode_event, decode_reply, encode_heartbeat

if TYPE_CHECKING:
    import zenoh

_PATIENCE_S: Final = 0.02
"""Real seconds that an urgent message waits for another one's link, before its robot's own thread sends it."""

_BEATS: Final = 4
"""Heartbeats in the time of the dead-man's switch."""

_LOOK_EACH_S: Final = 0.25
"""Real seconds between two looks at what was not answered in time."""


class Controller(EALActor):
    """The network of one fleet in this process; it opens when the first robot joins.

    Args:
        config: the fleet.
        clock: the fleet's clock.
        robots: names of the robots to reach.

    Raises:
        ConfigError: its keys are missing.

    Attributes:
        fleet: the fleet's name.
        client: names this controller, anew in each process.
        certificate: the name of the certificate that it shows; None where the fleet has no security.
        name_for_people: what it is called by robots.
        sender: sends the calls to all robots.
        pace: of the calls to all robots.

    Thread: an actor, which opens the session and sends the heartbeat. What zenoh's threads tell is passed on at once.
    """

    def __init__(self, config: FleetConfig, clock: Clock, robots: Iterable[str] | None = None) -> None:
        super().__init__(f"{config.name} network", clock)
        self.fleet: Final = config.name
        self.client: Final = secrets.token_hex(8)
        security = config.network.security
        self.certificate: Final = None if security is None else security.controller
        self._caller = self.certificate or keys.ANYBODY
        self.name_for_people: Final = process_name(self.certificate)
        self._config = config
        self._network = controller_config(config, robots)
        self._lock = threading.Lock()
        self._robots: dict[str, Reached] = {}
        self._versions: dict[str, int] = {}  # of the robots whose signs of life are there
        self._session: zenoh.Session | None = None
        self._stack = ExitStack()
        self._sequence = 0
        self.pace: Final = Pace()
        self.sender: Final = Sender(f"{config.name} sender", self.pace)
        self._urgent = Sender(f"{config.name} urgent sender")
        self._aide = EALActor(f"{config.name} callbacks", clock)

    # Life.

    def launch(self) -> Self:
        """Start; see EALActor."""
        self.sender.launch()
        self._urgent.launch()
        self._aide.launch()
        return super().launch()

    @property
    def timekeeper(self) -> Inbox:
        """Rings the deadlines of calls to all robots: one alarm does for what waits for many."""
        return self._aide.actor_inbox

    def urge(self, message: UrgentMessage) -> None:
        """Have a message sent past everything that waits, even while a link is stalled. Thread: any; does not block."""
        self._urgent.submit(message)
        self.timekeeper.call_later(self.clock.of_real(_PATIENCE_S), message.insist)

    def later(self, action: Callable[[], None]) -> None:
        """Run what follows from an answer, such as callbacks, off zenoh's threads. Thread: any; does not block."""
        try:
            self._aide.actor_inbox.call_soon(action)
        except EALError:  # everything is over, and nobody is held up any more
            action()

    def on_start(self) -> None:
        """Open the session. Thread: the actor's own; may take seconds where a router does not answer."""
        self._open()

    def _open(self) -> None:
        import zenoh

        try:
            session = self._stack.enter_context(open_session(self._network))
        except EALError as error:
            get_logger(fleet=self.fleet).error("the network cannot be opened", reason=error.message)
            with self._lock:
                robots = list(self._robots.values())
            for robot in robots:
                robot.gone(f"cannot be reached: {error.message}")
            self.actor_inbox.call_later(self.clock.of_real(1.0), self._open)
            return
        self._session = session
        callback = zenoh.handlers.Callback
        answers = keys.answer_keys(self.fleet, self._caller, self.client)
        session.declare_subscriber(answers, callback(self._on_answer, indirect=False))
        session.liveliness().declare_subscriber(
            keys.alive_keys(self.fleet), callback(self._on_liveliness, indirect=False), history=True
        )
        session.declare_subscriber(keys.event_keys(self.fleet), callback(self._on_event, indirect=False))
        self._beat()
        self._look()

    def _beat(self) -> None:
        self._sequence += 1
        if self._session is not None:
            import zenoh

            beat = encode_heartbeat(Heartbeat(self.client, 0, self._sequence, self.name_for_people))
            try:
                self._session.put(
                    keys.heartbeat_key(self.fleet, self.client),
                    beat,
                    priority=zenoh.Priority.REAL_TIME,
                    congestion_control=zenoh.CongestionControl.DROP,
                    express=True,
                )
            except zenoh.ZError as error:
                get_logger(fleet=self.fleet).debug("a heartbeat could not be sent", reason=error_text(error))
        period_s = self._config.network.dead_man_s / _BEATS
        self.actor_inbox.call_later(self.clock.of_real(period_s), self._beat)

    def _look(self) -> None:
        with self._lock:
            robots = list(self._robots.values())
        now_s = REAL_TIME.now()
        for robot in robots:
            robot.look(now_s)
        self.actor_inbox.call_later(self.clock.of_real(_LOOK_EACH_S), self._look)

    def shut_down(self) -> None:
        """Close the session, and end. Thread: any; does not block."""
        try:
            self.actor_inbox.call_soon(self._stop)
        except EALError:
            return

    def on_stop(self) -> None:
        """Close the session. Thread: the actor's own; bounded in time."""
        self._session = None
        self.sender.end_soon()
        self._urgent.end_soon()
        self._aide.end_soon()
        self._stack.close()

    def on_crash(self, error: BaseException) -> None:
        """See on_stop."""
        get_logger(fleet=self.fleet).error("the network has crashed", error=error_text(error))
        self.on_stop()

    def join(self, timeout_s: float) -> bool:
        """Wait (real time) for its end; return whether it came. Thread: blocks the caller."""
        end_s = REAL_TIME.now() + timeout_s
        threads = [actor.thread for actor in (self, self.sender, self._urgent, self._aide) if actor.thread is not None]
        with self.clock.outside():
            for thread in threads:
                thread.join(max(0.0, end_s - REAL_TIME.now()))
        return not any(thread.is_alive() for thread in threads)

    # Robots. Thread: any.

    def add(self, robot: Reached) -> None:
        """Tell a robot's connection of its signs of life from now on."""
        with self._lock:
            self._robots[robot.name] = robot
            version = self._versions.get(robot.name)
        if version is not None:
            robot.met(version)

    def remove(self, robot: Reached) -> None:
        """Tell it no more."""
        with self._lock:
            if self._robots.get(robot.name) is robot:
                del self._robots[robot.name]

    def is_alive(self, robot: str) -> bool:
        """Return whether the robot's sign of life is there, and says that it speaks our version."""
        return self._versions.get(robot) == PROTOCOL_VERSION

    def subscribe(self, key: str, take: Callable[[zenoh.Sample], None]) -> Callable[[], None] | None:
        """Take what is published on a key, in zenoh's threads.

        Returns:
            What ends it; None where the network is not open yet.
        """
        session = self._session
        if session is None:
            return None
        import zenoh

        try:
            subscriber = session.declare_subscriber(key, zenoh.handlers.Callback(take, indirect=False))
        except zenoh.ZError as error:
            get_logger(fleet=self.fleet).debug("a subscription failed", key=key, reason=error_text(error))
            return None

        def end() -> None:
            with contextlib.suppress(zenoh.ZError):  # the session is closed
                subscriber.undeclare()  # type: ignore[no-untyped-call]  # zenoh's stubs say nothing of it

        return end

    def call_key(self, robot: str, resource: str, method: str) -> str:
        """Return the key of our calls of a method."""
        return keys.call_key(keys.CallKey(self.fleet, robot, resource, method, self._caller, self.client))

    def put(
        self, robot: str, key: str, envelope: bytes, payload: Payload, *, is_urgent: bool = False, is_last: bool = True
    ) -> bool:
        """Send a call to a robot; return whether an answer may come: False if the robot is not there.

        What is urgent is sent past everything that waits in the link. What is not the last may travel together with
        what follows.

        Thread: any that may wait; blocks only while a link is full, at most until the engine gives that link up.
        """
        session = self._session
        if session is None:
            return False
        import zenoh

        try:
            session.put(
                key,
                payload if type(payload) is bytes else bytes(payload),
                priority=zenoh.Priority.REAL_TIME if is_urgent else zenoh.Priority.DATA,
                congestion_control=zenoh.CongestionControl.BLOCK,
                express=is_last,
                attachment=envelope,
            )
        except zenoh.ZError as error:
            get_logger(fleet=self.fleet).debug("a call could not be sent", key=key, reason=error_text(error))
            return False
        return self.is_alive(robot)  # else it has gone, maybe before the call was waited for

    # What comes from the network, in zenoh's threads.

    def _on_liveliness(self, sample: zenoh.Sample) -> None:
        import zenoh

        try:
            _, name, version = keys.parse_alive(str(sample.key_expr))
        except ProtocolError:
            return
        is_there = sample.kind == zenoh.SampleKind.PUT
        with self._lock:
            robot = self._robots.get(name)
            if is_there:
                self._versions[name] = version
            elif self._versions.get(name) == version:
                del self._versions[name]
            else:  # it has been updated, and what it was before goes last
                return
        if robot is None:
            return
        if is_there:
            robot.met(version)
        else:
            robot.gone("is out of reach")

    def _on_answer(self, sample: zenoh.Sample) -> None:
        attachment = sample.attachment
        try:
            _, name = keys.parse_robot(str(sample.key_expr))
        except ProtocolError:
            return
        try:
            reply = decode_reply(attachment.to_bytes() if attachment is not None else b"", sample.payload.to_bytes())
        except ProtocolError as error:
            reply = Reply(0, error)
        robot = self._robots.get(name)
        if robot is not None:
            robot.hear_reply(reply)

    def _on_event(self, sample: zenoh.Sample) -> None:
        attachment = sample.attachment
        try:
            _, name = keys.parse_robot(str(sample.key_expr))
            event = decode_event(attachment.to_bytes() if attachment is not None else b"", sample.payload.to_bytes())
        except ProtocolError as error:
            get_logger(fleet=self.fleet).warning("an event makes no sense", reason=error.message)
            return
        with self._lock:
            robot = self._robots.get(name)
        if robot is None:
            return
        try:
            robot.tell(event)
        except ProtocolError as error:
            get_logger(robot=name).warning("an event makes no sense", reason=error.message)
