"""RobotServer: offers the resources of a robot of this process to the controllers of a network.

Zenoh's threads only decode, check and put calls into the resources' mailboxes. Answers leave from the thread of the
resource that made them; those to commands from the server's own, so that a controller that reads none cannot hold up
an actuator.
"""

from __future__ import annotations

import contextlib
import secrets
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from eal_actors.actors.actor import EALActor
from eal_actors.actors.call import MOTION_METHODS, Call
from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.actors.robot_view import RobotState, release
from eal_actors.clock import REAL_TIME
from eal_actors.data import EALData
from eal_actors.errors import (
    DeadlineError,
    EALError,
    ProtocolError,
    ResourceFaultError,
    StaleCommandError,
    UnavailableError,
    shown,
)
from eal_actors.info import ResourceType
from eal_actors.log import get_logger
from eal_actors.managers.network_model import NetworkConfig
from eal_actors.net import keys
from eal_actors.net.calling import READS, start_call
from eal_actors.net.deadman import DeadMan
from eal_actors.net.leases import Leases
from eal_actors.net.publishing import StreamPublisher
from eal_actors.net.receipts import Receipts, Stamp
from eal_actors.net.timing import fleet_time_of, real_time_of
from eal_actors.net.turnstile import Turnstile
from eal_actors.net.wire import (
    ACCEPTED,
    Answer,
    CallHeader,
    CallId,
    Event,
    RobotTime,
    decode_call,
    decode_heartbeat,
    encode_answer,
    encode_event,
)

if TYPE_CHECKING:
    import zenoh

AT_ONCE_S: Final = 0.1
"""Real seconds that a command's query waits at least for its end; after that it is accepted, and tells later."""

_CLAIMING: Final = MOTION_METHODS | {"set_config"}
"""What takes an actuator for one controller."""
_LOOK_EACH_S: Final = (0.02, 0.25)


@dataclass(eq=False)
class _Running:
    """A command under way.

    Attributes:
        call_id: which it is.
        key: of its method, on which it is answered.
        query: what waits for the answer; None once that was given.
        call: the call to the resource.
        since_s: when it came.
    """

    call_id: CallId
    key: str
    query: zenoh.Query | None
    call: Call[Any]
    since_s: float


class RobotServer(EALActor):
    """Serves one robot.

    Args:
        fleet: the fleet's name.
        robot: a started robot of this process.
        session: an open session, which outlives the server.
        network: the fleet's network.
        turnstile: through which the answers of all servers of the session pass; one of its own if None.

    Thread: an actor.
    """

    def __init__(
        self,
        fleet: str,
        robot: RobotHandle,
        session: zenoh.Session,
        network: NetworkConfig,
        turnstile: Turnstile | None = None,
    ) -> None:
        super().__init__(f"{robot.name} server", robot.clock)
        self._fleet = fleet
        self._robot = robot
        self._session = session
        self._network = network
        self._turnstile = turnstile if turnstile is not None else Turnstile()
        self._era = secrets.token_hex(4)
        self._guard = threading.Lock()
        self._receipts: Receipts[Answer] = Receipts(self._era)
        self._leases = Leases(_actuators(robot), network.dead_man_s)
        self._dead_man = DeadMan(network.dead_man_s)
        self._running: dict[CallId, _Running] = {}
        self._publisher = StreamPublisher(fleet, robot, session, self._era)
        self._declared: list[Any] = []
        self._state = robot.state
        self._log = get_logger(robot=robot.name)

    # Life.

    def on_start(self) -> None:
        """Declare the robot to the network. Thread: the actor's own."""
        import zenoh

        session, robot_key = self._session, keys.robot_key(self._fleet, self._robot.name)
        callback = zenoh.handlers.Callback
        self._declared = [
            session.declare_queryable(f"{robot_key}/**", callback(self._on_query, indirect=False)),
            session.declare_subscriber(keys.heartbeat_keys(self._fleet), callback(self._on_heartbeat, indirect=False)),
            session.liveliness().declare_token(self._own_key(keys.ALIVE)),
        ]
        self._look()

    def shut_down(self) -> None:
        """Take leave of the network. Thread: any; does not block."""
        self._soon(self._shut_down)

    def close(self, timeout_s: float) -> None:
        """Take leave of the network, and wait for the end. Thread: blocks the caller."""
        self.shut_down()
        thread = self.thread
        if thread is not None:
            with self.clock.outside():
                thread.join(timeout_s)
            if thread.is_alive():
                self._log.error("the server did not end in time and was left behind")

    def _shut_down(self) -> None:
        for declared in reversed(self._declared):
            declared.undeclare()
        self._declared = []
        self._publisher.close()
        self._stop()

    def on_crash(self, error: BaseException) -> None:
        """Halt what nobody watches any more, and take leave. Thread: the actor's own."""
        self._log.error("the server has crashed; the robot is halted", error=shown(error))
        self._robot.halt()
        self._shut_down()

    def _own_key(self, method: str) -> str:
        return keys.method_key(self._fleet, self._robot.name, keys.ROBOT, method)

    def _soon(self, action: Callable[[], None]) -> None:
        try:
            self.actor_inbox.call_soon(action)
        except EALError:  # the server has ended
            self._log.debug("the server has ended; something came too late")

    def _look(self) -> None:
        """See after silent controllers, long commands and the robot's state, again and again."""
        self._halt_silent()
        self._accept_long()
        if self._robot.state is not self._state:
            self._state = self._robot.state
            self._publish(Event("state", REAL_TIME.now(), fields={"state": self._state.value}))
        least_s, most_s = _LOOK_EACH_S
        period_s = min(max(self._network.dead_man_s / 10, least_s), most_s)
        self.actor_inbox.call_later(self.clock.of_real(period_s), self._look)

    def _halt_silent(self) -> None:
        with self._guard:
            silences = self._dead_man.due(REAL_TIME.now())
        for silence in silences:
            self._log.warning("its controller is silent: halted", resource=silence.resource, controller=silence.client)
            self._robot[silence.resource].halt()
            fields = {"resource": silence.resource, "client": silence.client}
            self._publish(Event("dead_man", REAL_TIME.now(), fields=fields))

    # What comes from the network, in zenoh's threads.

    def _on_heartbeat(self, sample: zenoh.Sample) -> None:
        try:
            beat = decode_heartbeat(sample.payload.to_bytes())
        except ProtocolError as error:
            self._log.warning("a heartbeat makes no sense", reason=error.message)
            return
        with self._guard:
            now_s = REAL_TIME.now()
            self._dead_man.heard(beat.client, now_s)
            self._leases.renew(beat.client, now_s)

    def _on_query(self, query: zenoh.Query) -> None:
        key = str(query.key_expr)
        try:
            _, _, resource, method = keys.parse_method(key)
            attachment, payload = query.attachment, query.payload
            header, data = decode_call(
                attachment.to_bytes() if attachment is not None else b"",
                payload.to_bytes() if payload is not None else b"",
            )
            if resource == keys.ROBOT:
                self._serve_robot(method, query, key, header)
            else:
                self._serve(self._robot[resource], method, query, key, header, data)
        except EALError as error:
            self._answer(query, key, error.at(self._robot.name))
        except Exception as error:  # noqa: BLE001  # else the caller would get no answer at all
            self._log.exception("a query failed", key=key)
            self._answer(query, key, ResourceFaultError(f"the server raised {shown(error)}"))

    def _serve(
        self,
        handle: ResourceHandle,
        method: str,
        query: zenoh.Query,
        key: str,
        header: CallHeader,
        data: EALData | None,
    ) -> None:
        if method == keys.INFO:
            self._answer(query, key, handle.info.to_dict())
            return
        if method == keys.STREAM:
            with self._guard:
                self._publisher.serve(handle, header)
            self._answer(query, key, 1)
            return
        if header.deadline_s <= 0:
            raise DeadlineError(f"{method} came after its deadline; it was not executed")
        stops = method == keys.HALT or _is_stop(handle, method, header)
        if method in READS or stops:
            if stops:
                self._note_stop(handle, header)
            call = start_call(handle, method, header.arguments, data, header.deadline_s, None)
            call.add_done_callback(lambda done: self._answer(query, key, _outcome(done)))
            return
        begin_by_s = self.clock.now() + self.clock.of_real(self._check(handle, method, header))
        start_s = None if header.start_s is None else fleet_time_of(self.clock, header.start_s)
        try:
            call = start_call(handle, method, header.arguments, data, header.deadline_s, begin_by_s, start_s)
        except EALError as error:
            with self._guard:
                self._receipts.finish(header.call_id, error)
            raise
        running = _Running(header.call_id, key, query, call, REAL_TIME.now())
        with self._guard:
            self._running[running.call_id] = running
        call.add_done_callback(lambda _: self._finish(running))

    def _note_stop(self, handle: ResourceHandle, header: CallHeader) -> None:
        """Refuse from now on the commands that a stop has overtaken on its way; it is itself obeyed however old."""
        stamp = Stamp(header.call_id, header.ttl_s, header.era, header.echo_s, header.held_s)
        with self._guard:
            with contextlib.suppress(StaleCommandError):  # then whatever it has overtaken is stale too
                self._receipts.accept(stamp, handle.name, REAL_TIME.now())
                self._receipts.finish(header.call_id, 1)
            self._dead_man.halted(handle.name)

    def _check(self, handle: ResourceHandle, method: str, header: CallHeader) -> float:
        """Let a command pass: fresh, for the first time, and from whoever holds the resource.

        Returns:
            Real seconds within which it must begin.
        """
        stamp = Stamp(header.call_id, header.ttl_s, header.era, header.echo_s, header.held_s)
        self._halt_silent()  # before another controller's first command
        with self._guard:
            now_s = REAL_TIME.now()
            self._receipts.accept(stamp, handle.name, now_s)
            try:
                if method in _CLAIMING:
                    self._leases.claim(header.client, handle.name, now_s)
            except EALError as error:
                self._receipts.finish(header.call_id, error)
                raise
            if method in MOTION_METHODS:
                self._dead_man.commanded(header.client, handle.name, now_s)
        return stamp.begin_by_s - now_s

    # Commands.

    def _finish(self, running: _Running) -> None:
        """Tell what a command came to. Thread: whichever finishes it, mostly its resource's."""
        outcome = _outcome(running.call)
        with self._guard:
            self._running.pop(running.call_id, None)
            self._receipts.finish(running.call_id, outcome)
            query, running.query = running.query, None
        began_s = running.call.began_s
        if began_s is not None:
            began_s = real_time_of(self.clock, began_s)
        if query is not None:
            self._answer(query, running.key, outcome, later=True, began_s=began_s)
        else:
            fields = {} if began_s is None else {"began_s": began_s}
            event = Event("result", REAL_TIME.now(), running.call_id, outcome, fields)
            self._soon(lambda: self._publish(event))

    def _accept_long(self) -> None:
        """Answer the queries of commands that take long: their outcome will be told as an event."""
        with self._guard:
            early_s = REAL_TIME.now() - AT_ONCE_S
            taken = [running for running in self._running.values() if running.query and running.since_s <= early_s]
            queries = [(running.query, running.key) for running in taken]
            for running in taken:
                running.query = None
        for query, key in queries:
            if query is not None:
                self._answer(query, key, ACCEPTED)

    # The robot itself.

    def _serve_robot(self, method: str, query: zenoh.Query, key: str, header: CallHeader) -> None:
        if method == keys.PING:
            received_s = REAL_TIME.now()
            about = {**self._about(), "resources": len(self._robot)}
            self._answer(query, key, {**about, "received_s": received_s, "replied_s": REAL_TIME.now()})
        elif method == keys.STOP:
            reason = " ".join(map(str, header.arguments))
            self._log.warning("emergency stop", reason=reason)
            stopped = self._robot.stop(reason)
            stopped.add_done_callback(lambda done: self._answer(query, key, _outcome(done)))
        elif method == keys.RESUME:
            self._log.warning("resumed")
            self._robot.resume().add_done_callback(lambda done: self._answer(query, key, _outcome(done)))
        else:
            act = {
                keys.HELLO: self._hello,
                keys.REATTACH: self._reattach,
                keys.CANCEL: self._cancel,
                keys.LEAVE: self._leave,
            }[method]
            self._soon(lambda: self._act(partial(act, header), query, key))

    def _act(self, act: Callable[[], Answer], query: zenoh.Query, key: str) -> None:
        try:
            answer = act()
        except EALError as error:
            answer = error.at(self._robot.name)
        except Exception as error:  # noqa: BLE001  # what a controller sends must not end the server
            answer = ProtocolError(f"the query makes no sense: {shown(error)}", robot=self._robot.name)
        self._answer(query, key, answer)

    def _hello(self, header: CallHeader) -> Answer:
        with self._guard:
            now_s = REAL_TIME.now()
            self._receipts.enter(header.client, header.epoch, now_s)
            running = [[*call_id] for call_id in self._running]
        if self._robot.state is RobotState.STARTING:
            raise UnavailableError("it is still starting")
        return {
            **self._about(),
            "problems": [shown(problem) for problem in self._robot.problems],
            "resources": [handle.info.to_dict() for handle in self._robot.values()],
            "running": running,
        }

    def _about(self) -> dict[str, Any]:
        with self._guard:
            holders = self._leases.holders(REAL_TIME.now())
        return {
            "release": release(),
            "state": self._robot.state.value,
            "stopped": self._robot.stopped_because,
            "holders": holders,
        }

    def _reattach(self, header: CallHeader) -> Answer:
        """Tell what is known of commands; the outcomes of those that have ended are told once more."""
        numbers = [int(number) for number in header.arguments]
        running, unknown = [], []
        for epoch, sequence in zip(numbers[::2], numbers[1::2], strict=False):
            call_id = CallId(header.client, epoch, sequence)
            with self._guard:
                receipt = self._receipts.recall(call_id)
            if receipt is None:
                unknown.append([epoch, sequence])
            elif receipt.is_finished:
                self._publish(Event("result", REAL_TIME.now(), call_id, receipt.outcome))
            else:
                running.append([epoch, sequence])
        return {"running": running, "unknown": unknown}

    def _cancel(self, header: CallHeader) -> Answer:
        epoch, sequence = (int(number) for number in header.arguments)
        with self._guard:
            running = self._running.get(CallId(header.client, epoch, sequence))
        if running is not None:
            running.call.cancel()
        return 1

    def _leave(self, header: CallHeader) -> Answer:
        """Let a controller go: what it commanded is halted, what it held is free."""
        with self._guard:
            resources = self._dead_man.leave(header.client)
            self._leases.leave(header.client)
            self._publisher.leave(header.client)
        for resource in resources:
            self._robot[resource].halt()
        return 1

    # Answers.

    def _answer(
        self, query: zenoh.Query, key: str, answer: Answer, *, later: bool = False, began_s: float | None = None
    ) -> None:
        """Answer a query, once.

        Args:
            query: the query.
            key: of its method.
            answer: what to answer.
            later: send it from the server's own thread: no actuator waits for a controller that does not read.
            began_s: when the command began, of one with a time to begin.

        Thread: any; else may block while the link to the controller is full.
        """
        try:
            envelope, payload = encode_answer(answer, RobotTime(self._era, REAL_TIME.now(), began_s))
        except EALError as error:  # too large, say
            envelope, payload = encode_answer(error.at(self._robot.name), RobotTime(self._era, REAL_TIME.now()))

        def send() -> None:
            try:
                with query:
                    query.reply(key, bytes(payload), attachment=envelope, express=True)
            except Exception as error:  # noqa: BLE001  # zenoh's own: the link broke, or the session is being closed
                self._log.debug("an answer could not be sent", key=key, reason=shown(error))

        if later:
            self._soon(lambda: self._turnstile.enter(send))
        else:
            self._turnstile.enter(send)

    def _publish(self, event: Event) -> None:
        import zenoh

        envelope, payload = encode_event(event)
        try:
            self._session.put(
                self._own_key(keys.EVENTS),
                bytes(payload),
                attachment=envelope,
                express=True,
                congestion_control=zenoh.CongestionControl.BLOCK,  # an outcome must not be lost
            )
        except Exception as error:  # noqa: BLE001  # as above
            self._log.debug("an event could not be sent", kind=event.kind, reason=shown(error))


def _outcome(done: Future[Any]) -> Answer:
    """Return what a finished call came to."""
    error = done.exception()
    if error is None:
        value = done.get()
        return 1 if value is None else value
    return error if isinstance(error, EALError) else ResourceFaultError(shown(error))


def _is_stop(handle: ResourceHandle, method: str, header: CallHeader) -> bool:
    """Return whether a call is a command that only stops: anybody may give it at any time, as a halt."""
    return method == "send_cmd" and header.arguments[:1] != () and header.arguments[0] in handle.info.urgent_commands


def _actuators(robot: RobotHandle) -> list[str]:
    return [name for name, handle in robot.items() if handle.info.types & ResourceType.ACTUATOR]
