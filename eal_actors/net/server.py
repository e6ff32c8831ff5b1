"""RobotServer: offers the resources of a robot of this process to the controllers of a network.

Zenoh's threads only decode, check and put calls into the resources' mailboxes. Answers leave through the outbox of the
session, so that a controller that reads none cannot hold up an actuator; those to readings, from the resource's own
thread where nobody else is sending.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, Final, Self

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.device.data import EALData
from eal_actors.device.info import ResourceType
from eal_actors.kernel import spans
from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.errors import (
    DeadlineError,
    EALError,
    ProtocolError,
    ResourceFaultError,
    UnavailableError,
    error_text,
)
from eal_actors.kernel.log import get_logger
from eal_actors.managers.network_model import NetworkConfig
from eal_actors.net import keys
from eal_actors.net.admission import Admission
from eal_actors.net.calling import READS, start_call
from eal_actors.net.desk import Desk
from eal_actors.net.host import Host
from eal_actors.net.keys import CallKey
from eal_actors.net.publishing import StreamPublisher
from eal_actors.net.stamps import stamp_in, stamp_out
from eal_actors.net.timing import fleet_time_of, real_time_of
from eal_actors.net.underway import Running, UnderWay
from eal_actors.net.wire import (
    ACCEPTED,
    Answer,
    CallHeader,
    Event,
    Reply,
    ReplyTo,
    RobotTime,
    decode_call,
    encode_event,
    encode_reply,
)

if TYPE_CHECKING:
    import zenoh

AT_ONCE_S: Final = 0.1
"""Real seconds that the answer to a command waits at least for its end; after that it is accepted, and tells later."""


class RobotServer:
    """Serves one robot.

    Args:
        fleet: the fleet's name.
        robot: a started robot of this process.
        session: an open session, which outlives the server.
        network: the fleet's network.
        host: what all servers of the session share, which outlives them; one of its own if None.
        exclusive: names of the resources that one controller at a time may command; every actuator if None.

    Attributes:
        dead_man_trips: how often each resource was halted because its controller was silent.

    Thread: any; what may take a moment happens in the host's.
    """

    def __init__(
        self,
        fleet: str,
        robot: RobotHandle,
        session: zenoh.Session,
        network: NetworkConfig,
        host: Host | None = None,
        *,
        exclusive: Iterable[str] | None = None,
    ) -> None:
        self._fleet = fleet
        self._robot = robot
        self._clock = robot.clock
        self._session = session
        self._is_own_host = host is None
        self._host = host if host is not None else Host(fleet, session, network.dead_man_s, robot.name)
        self._outbox = self._host.outbox
        self._era = secrets.token_hex(4)
        self._events = keys.event_key(fleet, robot.name)
        self._admission = Admission(
            self._era, _actuators(robot) if exclusive is None else exclusive, network.dead_man_s
        )
        self._under_way = UnderWay()
        self._publisher = StreamPublisher(fleet, robot, session, self._era)
        self._desk = Desk(robot, self._admission, self._under_way, self._publisher, self._publish, network.security)
        self._token: zenoh.LivelinessToken | None = None
        self._stopped_for: str | None = None
        self._forsaken = new_waiter()
        self._is_forsaken = False
        self.dead_man_trips: dict[str, int] = {}
        self._state = robot.state
        self._log = get_logger(robot=robot.name)

    # Life.

    def launch(self) -> Self:
        """Declare the robot to the network. Thread: blocks the caller for a moment."""
        if self._is_own_host:
            self._host.launch()
        self._host.add(self._robot.name, self)
        self._token = self._session.liveliness().declare_token(keys.alive_key(self._fleet, self._robot.name))
        return self

    def close(self, timeout_s: float) -> None:
        """Take leave of the network. Thread: blocks the caller, for a bounded time."""
        self._withdraw()
        if self._is_own_host:
            self._host.close(timeout_s)

    def _withdraw(self) -> None:
        token, self._token = self._token, None
        if token is not None:
            token.undeclare()  # type: ignore[no-untyped-call]  # zenoh's stubs say nothing of it
        self._host.remove(self._robot.name)
        self._publisher.close()

    def wait(self) -> None:
        """Wait, which takes for ever, unless the server crashes.

        Raises:
            UnavailableError: it has crashed; the robot is halted, and nobody can reach it any more.

        Thread: blocks the caller.
        """
        while not self._is_forsaken:
            REAL_TIME.wait(self._forsaken, None)
        raise UnavailableError("its server has crashed; the robot is halted", robot=self._robot.name)

    # What the host tells; see Served.

    def look(self) -> None:
        """See after silent controllers, long commands and the robot's state."""
        self._halt_silent()
        for running, to in self._under_way.take_long(REAL_TIME.now() - AT_ONCE_S):
            self._outbox.expect(-1)
            self._answer(to, ACCEPTED)  # its outcome will be told as an event
            running.call.arm()  # what goes on beyond its deadline is stopped
        self._tell_what_runs()
        reason, self._stopped_for = self._stopped_for, None
        if reason is not None:  # not at once: other robots are still to be stopped
            self._log.warning("emergency stop", reason=reason)
        if self._robot.state is not self._state:
            self._state = self._robot.state
            self._publish(Event("state", REAL_TIME.now(), fields={"state": self._state.value}))

    def _tell_what_runs(self) -> None:
        """Tell everybody what has begun and takes long, and how far it has come."""
        now_s = REAL_TIME.now()
        for running in self._under_way.take_begun():
            self._publish(Event("began", now_s, running.call_id, fields=running.about()))
        for running in self._under_way.take_progressed(now_s):
            self._publish(Event("progress", now_s, running.call_id, fields=running.progress()), is_vital=False)

    def hear(self, client: str, name: str) -> None:
        """Take in a controller's sign of life."""
        self._admission.hear(client)
        self._admission.names.note(client, name)

    def forsake(self) -> None:
        """Halt the robot, and take leave: nobody looks after it any more."""
        self._robot.halt()
        self._withdraw()
        self._is_forsaken = True
        REAL_TIME.wake(self._forsaken)

    def _halt_silent(self) -> None:
        for silence in self._admission.silences():
            controller = self._admission.names.of(silence.client)
            self.dead_man_trips[silence.resource] = self.dead_man_trips.get(silence.resource, 0) + 1
            self._log.warning("its controller is silent: halted", resource=silence.resource, controller=controller)
            self._robot[silence.resource].halt()
            fields = {"resource": silence.resource, "client": silence.client}
            self._publish(Event("dead_man", REAL_TIME.now(), fields=fields))

    # What comes from the network, in zenoh's threads.

    def take(self, call: CallKey, envelope: bytes, payload: bytes) -> None:
        """See Served."""
        to = ReplyTo(keys.answer_key(call), 0)
        try:
            header, data = decode_call(envelope, payload)
            to = ReplyTo(to.key, header.sequence)
            if header.client != call.client:
                raise ProtocolError(f"{call.client} calls in the name of {header.client}")
            if data is not None:
                data = stamp_in(data, self._clock)
            with spans.within(header.traceparent):
                if call.resource == keys.ROBOT:
                    self._serve_robot(call.method, to, header)
                else:
                    self._serve(self._robot[call.resource], call.method, to, header, data)
        except EALError as error:
            self._answer(to, error.at(self._robot.name))
        except Exception as error:  # noqa: BLE001  # else the caller would get no answer at all
            self._log.exception("a call failed", method=call.method, resource=call.resource)
            self._answer(to, ResourceFaultError(f"the server raised {error_text(error)}"))

    def _serve(
        self, handle: ResourceHandle, method: str, to: ReplyTo, header: CallHeader, data: EALData | None
    ) -> None:
        if method == keys.INFO:
            self._answer(to, handle.info.to_dict())
            return
        if method == keys.STREAM:
            self._publisher.serve(handle, header)
            self._answer(to, 1)
            return
        if header.deadline_s <= 0:
            raise DeadlineError(f"{method} came after its deadline; it was not executed")
        if method in READS:
            call = start_call(handle, method, header.arguments, data, header.deadline_s, None)
            call.link(lambda done, _: self._answer(to, self._outcome(done), send=self._outbox.publish_from_here))
        elif method == keys.HALT or _is_stop(handle, method, header):
            self._admission.note_stop(header, handle.name)
            call = start_call(handle, method, header.arguments, data, header.deadline_s, None)
            call.link(lambda done, _: self._answer(to._replace(is_urgent=True), self._outcome(done)))
        else:
            self._command(handle, method, to, header, data)

    def _command(
        self, handle: ResourceHandle, method: str, to: ReplyTo, header: CallHeader, data: EALData | None
    ) -> None:
        self._halt_silent()  # before another controller's first command
        begin_by_s = self._clock.now() + self._clock.of_real(self._admission.check(header, method, handle.name))
        start_s = None if header.start_s is None else fleet_time_of(self._clock, header.start_s)
        call_id = header.call_id
        self._outbox.expect(1, has_more=header.has_more)
        try:
            call = start_call(handle, method, header.arguments, data, header.deadline_s, begin_by_s, start_s)
        except EALError as error:
            self._outbox.expect(-1)
            self._admission.finish(call_id, error)
            raise
        call.caller = self._admission.names.of(header.client)
        running = Running(call_id, to, call, REAL_TIME.now())
        self._under_way.add(running)
        call.link(lambda _, __: self._finish(running))

    def _finish(self, running: Running) -> None:
        """Tell what a command came to. Thread: whichever finishes it, mostly its resource's."""
        outcome = self._outcome(running.call)
        self._admission.finish(running.call_id, outcome)
        to = self._under_way.end(running)
        began_s = running.call.began_s
        if began_s is not None:
            began_s = real_time_of(self._clock, began_s)
        if to is not None:
            self._answer_expected(to, outcome, began_s)
        else:
            fields = {} if began_s is None else {"began_s": began_s}
            self._publish(Event("result", REAL_TIME.now(), running.call_id, outcome, fields))

    # The robot itself.

    def _serve_robot(self, method: str, to: ReplyTo, header: CallHeader) -> None:
        if method == keys.PING:
            self._answer(to, self._desk.ping(), send=self._outbox.publish_from_here)
        elif method == keys.RELEASE:
            self._answer(to, self._desk.release(header))
        elif method == keys.STOP:
            reason = " ".join(map(str, header.arguments))
            self._outbox.expect(1, has_more=header.has_more)
            stopped = self._robot.stop(reason)
            stopped.link(lambda done, _: self._answer_expected(to._replace(is_urgent=True), self._outcome(done)))
            self._stopped_for = reason
        elif method == keys.RESUME:
            self._log.warning("resumed")
            self._robot.resume().link(lambda done, _: self._answer(to, self._outcome(done)))
        else:
            self._host.soon(lambda: self._answer(to, self._desk.answer(method, header)))

    # Answers.

    def _outcome(self, done: Future[Any]) -> Answer:
        """Return what a finished call came to."""
        error = done.exception()
        if error is not None:
            return error if isinstance(error, EALError) else ResourceFaultError(error_text(error))
        value = done.get()
        if isinstance(value, EALData):
            return stamp_out(value, self._clock)
        return 1 if value is None else value

    def _answer(
        self,
        to: ReplyTo,
        answer: Answer,
        *,
        began_s: float | None = None,
        send: Callable[..., None] | None = None,
    ) -> None:
        """Answer a call, once.

        Args:
            to: who called.
            answer: what to answer.
            began_s: when the command began, of one with a time to begin.
            send: the outbox's way to send it; None for the one that keeps nobody waiting.

        Thread: any.
        """
        time = RobotTime(self._era, REAL_TIME.now(), began_s)
        try:
            envelope, payload = encode_reply(Reply(to.sequence, answer, time))
        except EALError as error:  # too large, say
            envelope, payload = encode_reply(Reply(to.sequence, error.at(self._robot.name), time))
        (send or self._outbox.publish)(to.key, envelope, payload, is_urgent=to.is_urgent)

    def _answer_expected(self, to: ReplyTo, answer: Answer, began_s: float | None = None) -> None:
        self._answer(to, answer, began_s=began_s)
        self._outbox.expect(-1)

    def _publish(self, event: Event, *, is_vital: bool = True) -> None:
        self._outbox.publish(self._events, *encode_event(event), is_vital=is_vital)


def _is_stop(handle: ResourceHandle, method: str, header: CallHeader) -> bool:
    """Return whether a call is a command that only stops: anybody may give it at any time, as a halt."""
    return method == "send_cmd" and header.arguments[:1] != () and header.arguments[0] in handle.info.urgent_commands


def _actuators(robot: RobotHandle) -> list[str]:
    return [name for name, handle in robot.items() if handle.info.types & ResourceType.ACTUATOR]
