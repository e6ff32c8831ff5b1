"""RobotServer: offers the resources of a robot of this process to the controllers of a network.

The reader's thread only decodes, checks and queues calls in the resources' mailboxes, and reads values that take no
time (`Resource.glance`) while nothing waits there. The session's outbox sends the replies.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterable
from functools import partial
from typing import Any, Final

from eal_actors.actors.call import Call
from eal_actors.actors.future import Future, Relay
from eal_actors.actors.handles import MAX_REASON, ResourceHandle, RobotHandle
from eal_actors.device.data import EALData, Payload
from eal_actors.device.info import ResourceType
from eal_actors.kernel import spans
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import (
    AccessDeniedError,
    BusyError,
    DeadlineError,
    EALError,
    ProtocolError,
    ResourceFaultError,
    StaleCommandError,
    UnavailableError,
    error_text,
)
from eal_actors.kernel.log import get_logger
from eal_actors.wire.format import keys
from eal_actors.wire.format.messages import (
    ACCEPTED,
    CallHeader,
    CallId,
    Heartbeat,
    RobotEvent,
    decode_call,
    encode_event,
)
from eal_actors.wire.local_link import LocalLink
from eal_actors.wire.rpc.call_arguments import check_action, check_arguments, is_action, is_stop, start_call
from eal_actors.wire.rpc.server.admission import Admission
from eal_actors.wire.rpc.server.outbox import Replies, ReplyBatch, ReplyTo
from eal_actors.wire.rpc.server.request_handler import HostServices, RequestHandler
from eal_actors.wire.rpc.server.running_commands import RunningCommands, ServedCommand
from eal_actors.wire.rpc.server.server_tokens import ServerTokens
from eal_actors.wire.security.access import Rights, encode_rights
from eal_actors.wire.shared_memory import ControllerMemories
from eal_actors.wire.streams.publisher import StreamPublisher

ACCEPT_AFTER_S: Final = 0.1
"""Real seconds after which a running command is answered with ACCEPTED; its outcome follows as an event."""
_PROGRESS_PERIOD_S: Final = 0.25
"""Least real seconds between two lists of running commands, unless another one has begun."""


class RobotServer:
    """Serves one started robot of this process; made by RobotHost.serve. Thread: any; slow work runs in the host's.

    `tokens` announces it. `dead_man_trips` counts the halts of each resource because its controller was silent.
    """

    def __init__(self, host: HostServices, robot: RobotHandle, exclusive: Iterable[str] | None) -> None:
        self._host = host
        self._robot = robot
        self._handles: dict[str, ResourceHandle] = {}  # of a robot of this process, which keeps its resources
        self._clock = robot.clock
        self._second = robot.clock.of_real(1.0)
        self._outbox = host.outbox
        self._rights = encode_rights(host.network.security, robot.name)
        self._era = secrets.token_hex(4)
        self._event_key = keys.event_key(host.fleet, robot.name)
        if exclusive is None:
            exclusive = [name for name, handle in robot.items() if handle.info.types & ResourceType.ACTUATOR]
        self._admission = Admission(self._era, exclusive, host.network.dead_man_s, overtaken=robot.overtaken)
        self._running = RunningCommands()
        self._memories = ControllerMemories(robot.name, is_enabled=host.network.shared_memory)
        self._replies = Replies(robot, self._era, host.outbox, self._memories)
        self._answer, self._outcome = self._replies.answer, self._replies.outcome
        self._publisher = StreamPublisher(host.fleet, robot, host.outbox, self._era, self._memories.put)
        self.tokens: Final = ServerTokens(host.outbox, host.fleet, robot.name, host.process, host.network.lease_s)
        parts = self._admission, self._running, self._publisher, self._memories, self.tokens
        self._handler = RequestHandler(host, robot, *parts, self._publish)
        self._unlogged_stop: str | None = None
        self._ended = Future[None]()
        self.dead_man_trips: dict[str, int] = {}
        self._state = robot.state
        self._list_at_s = 0.0
        self._log = get_logger(robot=robot.name)

    # Life.

    def expel(self, caller: str) -> None:
        """Disconnect every controller with a revoked certificate, and halt what they moved. Thread: the host's."""
        for client in self._admission.clients_of(caller):
            self._log.warning("its certificate is revoked: disconnected", certificate=caller)
            self._handler.disconnect(client)

    def close(self, error: EALError | None = None) -> None:
        """Withdraw the robot from the network; `wait` raises the error. Thread: blocks for a bounded time."""
        self.tokens.withdraw()
        self._host.remove(self._robot.name)
        self._publisher.close()
        self._memories.close()
        self._ended.settle(None, error)

    def fail(self) -> None:
        """Halt the robot and withdraw it: its host has crashed. Thread: the host's."""
        self._robot.halt()
        self.close(UnavailableError("its server has crashed; the robot is halted", robot=self._robot.name))

    def wait(self) -> None:
        """Wait until the server is closed; UnavailableError if it has failed and halted. Thread: blocks the caller."""
        self._ended.get()

    # Calls of the host.

    def tick(self) -> None:
        """Check the dead-man's switch, long commands and the robot's state. Thread: the host's; does not block."""
        self._halt_silent()
        self._memories.check()
        for command, reply_to in self._running.take_long(REAL_TIME.now() - ACCEPT_AFTER_S):
            self._answer(reply_to, ACCEPTED)
            command.call.arm()  # from now on its deadline stops it
        self._list_commands()
        self._log_stop()
        if self._robot.state is not self._state:
            self._state = self._robot.state
            self._publish(RobotEvent("state", REAL_TIME.now(), fields={"state": self._state.value}))

    def _log_stop(self) -> None:
        """Log an emergency stop, late: other robots had to be stopped first."""
        reason, self._unlogged_stop = self._unlogged_stop, None
        if reason is not None:
            self._log.warning("emergency stop", reason=reason)

    def _list_commands(self) -> None:
        """Publish the list of long commands when another one has begun, and after a while when one has progressed."""
        now_s, commands = REAL_TIME.now(), self._running.listed()
        has_begun = any(not command.is_listed for command in commands)
        if not has_begun:
            has_progressed = any(command.call.progress() is not command.listed_progress for command in commands)
            if not has_progressed or now_s < self._list_at_s:
                return
        self._list_at_s = now_s + _PROGRESS_PERIOD_S
        for command in commands:
            command.is_listed, command.listed_progress = True, command.call.progress()
        rows = [command.to_row() for command in commands]
        self._publish(RobotEvent("running", now_s, fields={"running": rows}), is_vital=has_begun)

    def receive_heartbeat(self, caller: str, beat: Heartbeat) -> None:
        """Note a controller's heartbeat and display name. Thread: a reader's; does not block."""
        self._admission.heard(beat.client)
        self._admission.names.note(beat.client, caller, beat.name)

    def _halt_silent(self) -> None:
        for silent in self._admission.silences():
            controller = self._admission.names.of(silent.client)
            self.dead_man_trips[silent.resource] = self.dead_man_trips.get(silent.resource, 0) + 1
            self._log.warning("its controller is silent: halted", resource=silent.resource, controller=controller)
            silence = f"no heartbeat of its controller for {self._host.network.dead_man_s:g} s"
            self._robot[silent.resource].halt_because(silence)
            fields = {"resource": silent.resource, "client": silent.client}
            self._publish(RobotEvent("dead_man", REAL_TIME.now(), fields=fields))

    # Calls of controllers, in the readers' threads.

    def receive(
        self,
        route: keys.CallRoute,
        envelope: bytes,
        payload: Payload,
        batch: ReplyBatch | None = None,
        link: LocalLink | None = None,
    ) -> None:
        """Serve a call, of a batch or a local link if one is given. Thread: the reader's; does not block."""
        call, reply_to = route.call, None
        try:
            header, data = decode_call(envelope, payload)
            reply_to = tuple.__new__(ReplyTo, (route.answer_key, header.sequence, False, batch, link))
            if header.client != route.client:
                raise ProtocolError(f"a controller named {call.caller} calls in the name of another one")
            if data is not None and data.stamp_s is not None:
                data = data.with_meta(stamp_s=self._clock.from_real(data.stamp_s))
            if header.traceparent:
                with spans.within(header.traceparent):
                    self._dispatch(route, reply_to, header, data)
            else:
                self._dispatch(route, reply_to, header, data)
        except EALError as error:
            self._answer(reply_to or ReplyTo(route.answer_key, 0), error.at(self._robot.name))
        except Exception as error:  # noqa: BLE001  # else the caller would get no reply at all
            self._log.exception("a call failed", method=call.method, resource=call.resource)
            failure = ResourceFaultError(f"the server raised {error_text(error)}")
            self._answer(reply_to or ReplyTo(route.answer_key, 0), failure)

    def refuse(self, route: keys.CallRoute, number: int, error: BusyError) -> None:
        """Answer a call whose parts are not collected. Thread: the reader's; does not block."""
        self._answer(ReplyTo(route.answer_key, number), error.at(self._robot.name))

    def _handle(self, resource: str) -> ResourceHandle:
        handle = self._handles[resource] = self._robot[resource]
        return handle

    def _dispatch(self, route: keys.CallRoute, reply_to: ReplyTo, header: CallHeader, data: EALData | None) -> None:
        call = route.call
        if call.resource == keys.ROBOT:
            self._serve_robot(call, reply_to, header)
            return
        handle = self._handles.get(call.resource) or self._handle(call.resource)
        if call.method == "send_req" and is_action(handle.info, header.arguments):
            check_action(Rights.decode(self._rights, call.caller), call)
            self._serve_command(handle, call, reply_to, header, data)
        elif route.is_reading:
            self._serve_reading(handle, call, reply_to, header, data)
        elif call.method in keys.COMMANDS and not is_stop(handle, call.method, header):
            self._serve_command(handle, call, reply_to, header, data)
        else:
            self._serve_other(handle, call.method, reply_to, header, data)

    def _serve_reading(
        self, handle: ResourceHandle, call: keys.CallKey, reply_to: ReplyTo, header: CallHeader, data: EALData | None
    ) -> None:
        method = call.method
        if header.deadline_s <= 0:
            raise _too_late(method)
        if method != "get_value" or header.arguments:
            check_arguments(method, header.arguments, data)
        is_brief = method == "get_value" and handle.reads_now  # perhaps in this thread, which must not wait for a link
        send = self._outbox.publish_briefly if is_brief else self._outbox.publish_from_here
        answer = partial(self._replies.answer_reading, reply_to, header.client, send)
        handle.start_reading(method, header.arguments, header.deadline_s * self._second, answer)

    def _serve_other(
        self, handle: ResourceHandle, method: str, reply_to: ReplyTo, header: CallHeader, data: EALData | None
    ) -> None:
        if method == keys.STREAM:
            self._publisher.serve(handle, header)
            self._answer(reply_to, 1)
        elif header.deadline_s <= 0:
            raise _too_late(method)
        else:
            self._admission.note_stop(header, handle.name)
            self._answer_urgently(reply_to, start_call(handle, method, header, data, header.deadline_s * self._second))

    def _answer_urgently(self, reply_to: ReplyTo, call: Future[Any]) -> None:
        urgent = reply_to._replace(is_urgent=True)
        call.link(lambda done, _: self._answer(urgent, self._outcome(done)))

    def _serve_command(
        self, handle: ResourceHandle, key: keys.CallKey, reply_to: ReplyTo, header: CallHeader, data: EALData | None
    ) -> None:
        if header.deadline_s <= 0:
            raise _too_late(key.method)
        if REAL_TIME.now() >= self._admission.quiet_until_s:
            self._halt_silent()  # before another controller's first command
        caller = self._admission.names.note(header.client, key.caller)
        try:
            call_id, now_s, begin_in_s, left_s = self._admission.check(header, key.method, key.resource)
        except StaleCommandError:
            if header.era != self._era and self._outbox.transport.is_relayed:
                return  # perhaps another process serves the robot too, whose answer this one would replace
            raise
        start_s = None if header.start_s is None else self._clock.from_real(header.start_s)
        value_bytes = 0 if data is None else data.length
        prepare = partial(self._prepare, call_id, reply_to, caller, now_s, value_bytes)
        try:
            if value_bytes:
                self._running.check_room(value_bytes)
            begin_by_s = self._clock.now() + begin_in_s * self._second
            start_call(handle, key.method, header, data, left_s * self._second, begin_by_s, start_s, prepare)
        except EALError as error:
            self._admission.finish(call_id, error)
            raise

    def _prepare(
        self, call_id: CallId, reply_to: ReplyTo, caller: str, now_s: float, value_bytes: int, call: Call[Any]
    ) -> Relay:
        call.caller = caller
        command = ServedCommand(self._finish, call_id, reply_to, call, now_s, value_bytes)
        self._running.add(command)
        return command

    def _finish(self, command: ServedCommand) -> None:
        """Send the outcome of a command. Thread: the one that finishes it, usually its resource's."""
        outcome = self._outcome(command.call)
        self._admission.finish(command.call_id, outcome)
        reply_to = self._running.end(command)
        began_s = command.call.began_s
        if began_s is not None:
            began_s = self._clock.to_real(began_s)
        if reply_to is not None:
            self._answer(reply_to, outcome, began_s=began_s, send=self._outbox.publish_briefly)
        else:
            fields = {} if began_s is None else {"began_s": began_s}
            self._publish(RobotEvent("result", REAL_TIME.now(), command.call_id, outcome, fields))

    def _serve_robot(self, call: keys.CallKey, reply_to: ReplyTo, header: CallHeader) -> None:
        method = call.method
        if method == keys.PING:
            self._answer(reply_to, self._handler.ping(header), send=self._outbox.publish_from_here)
        elif method == keys.RELEASE:
            self._answer(reply_to, self._handler.release(header))
        elif method == keys.STOP:
            reason = " ".join(map(str, header.arguments))[:MAX_REASON]
            self._answer_urgently(reply_to, self._robot.stop(reason))
            self._unlogged_stop = reason
        elif method == keys.RESUME:
            self._admission.check_resume(header)
            self._log_stop()
            self._log.warning("resumed")
            self._answer_urgently(reply_to, self._robot.resume())
        elif method == keys.REVOKE and call.caller != keys.AUTHORITY_CALLER:
            raise AccessDeniedError("only the holder of the authority's key may revoke a certificate")
        else:
            if method == keys.HELLO:
                self._admission.names.note(header.client, call.caller, " ".join(map(str, header.arguments)))
            end_s = REAL_TIME.now() + header.deadline_s
            self._host.requests.add(call, header, lambda: self._answer_request(reply_to, method, header, end_s))

    def _answer_request(self, reply_to: ReplyTo, method: str, header: CallHeader, end_s: float) -> None:
        """Answer a call of the robot itself, other than a handshake that its controller has repeated by now.

        A busy process with many robots would else answer each handshake after its time-out, and never one in time.
        """
        if method != keys.HELLO or REAL_TIME.now() < end_s:
            self._answer(reply_to, self._handler.answer(method, header))

    # Replies and events. Thread: any.

    def _publish(self, event: RobotEvent, *, is_vital: bool = True) -> None:
        self._outbox.publish(self._event_key, *encode_event(event), is_vital=is_vital)


def _too_late(method: str) -> DeadlineError:
    return DeadlineError(f"{method} came after its deadline; it was not executed")
