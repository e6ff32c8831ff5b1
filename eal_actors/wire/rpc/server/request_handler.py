"""RequestHandler: answers calls of the robot itself, such as the handshake, pings and cancellations.

Every call gets an answer: an error becomes one, since arguments of a controller must not crash the host. The host's
thread answers one call at a time. Two methods run in the reader's thread: a ping, which would else measure the calls
before it, and a release, which must take effect before the controller's next command.
"""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import RobotState, release
from eal_actors.device.info import ResourceInfo
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import BusyError, DataError, EALError, ProtocolError, UnavailableError, error_text
from eal_actors.managers.keys.expiry import certificate_warnings
from eal_actors.managers.network_model import NetworkConfig
from eal_actors.wire.format import keys
from eal_actors.wire.format.messages import Answer, CallHeader, CallId, RobotEvent
from eal_actors.wire.format.packing import MAX_ITEMS, pack
from eal_actors.wire.rpc.call_arguments import check_texts
from eal_actors.wire.rpc.server.admission import Admission
from eal_actors.wire.rpc.server.outbox import Outbox
from eal_actors.wire.rpc.server.running_commands import RunningCommands
from eal_actors.wire.rpc.server.server_tokens import ServerTokens
from eal_actors.wire.security.accept_guard import descriptor_warnings
from eal_actors.wire.security.access import encode_rights
from eal_actors.wire.shared_memory import ControllerMemories
from eal_actors.wire.streams.publisher import StreamPublisher

MOST_WAITING: Final = 64
"""Limit of the waiting calls of one certificate to one robot."""
_MAX_TEXTS: Final = 16_384
_MAX_TEXT: Final = 500
"""Characters of a plugin's text in each ping and handshake: one that does not fit would keep all controllers out."""


def require_handshake(infos: Sequence[ResourceInfo]) -> None:
    """Raise DataError if no handshake holds the information of a robot's resources: no controller could connect."""
    if len(infos) > MAX_ITEMS:
        raise DataError(f"cannot be served: it has {len(infos)} resources, more than the {MAX_ITEMS} of a handshake")
    pack([info.to_dict() for info in infos], "cannot be served: the information of its resources")


class RequestQueue:
    """Queue of calls of the robots themselves, each an action, which `run` runs after the timers that are due.

    A handshake takes the thread longer than it takes a controller to send the next one. So the number of waiting calls
    is bounded for each certificate, and certificates take turns: a flood by one of them delays another's call by one
    call. Only one call at a time is in the host's mailbox, behind the timers that are due, so that a flood does not
    delay a dead-man's switch. Thread: any.
    """

    def __init__(self, run: Callable[[Callable[[], None]], None]) -> None:
        self._run = run
        self._lock = threading.Lock()
        self._waiting: OrderedDict[tuple[str, str], deque[Callable[[], None]]] = OrderedDict()
        self._is_serving = False

    def add(self, call: keys.CallKey, header: CallHeader, action: Callable[[], None]) -> None:
        """Queue a call. Does not block.

        Raises BusyError if too many calls of its certificate wait, and ProtocolError if its texts are too long.
        """
        check_texts(call.method, header.arguments, _MAX_TEXTS)
        owner = call.robot, keys.certificate_id(header.client)
        with self._lock:
            waiting = self._waiting.setdefault(owner, deque())
            if len(waiting) >= MOST_WAITING:
                raise BusyError(f"{MOST_WAITING} calls of this certificate wait for the robot")
            waiting.append(action)
            is_first, self._is_serving = not self._is_serving, True
        if is_first:
            self._run(self._serve_next)

    def _serve_next(self) -> None:
        with self._lock:
            owner, waiting = self._waiting.popitem(last=False)
            action = waiting.popleft()
            if waiting:
                self._waiting[owner] = waiting  # behind the others
            self._is_serving = has_more = bool(self._waiting)
        if has_more:
            self._run(self._serve_next)
        action()


class HostServices(NamedTuple):
    """Services of a host, which is a process with an identifier, for the servers of its robots.

    `requests` runs calls of the robots themselves in the host's thread; there `revoke` adds names to the list of
    revoked certificates. A server that is closed is removed.
    """

    fleet: str
    network: NetworkConfig
    outbox: Outbox
    process: str
    requests: RequestQueue
    revoke: Callable[[Iterable[str]], None]
    remove: Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class RequestHandler:
    """Answers for one robot. Thread: the host's, except `ping` and `release`."""

    _host: HostServices
    _robot: RobotHandle
    _admission: Admission
    _running: RunningCommands
    _publisher: StreamPublisher
    _memories: ControllerMemories
    _tokens: ServerTokens
    _publish: Callable[[RobotEvent], None]

    def ping(self, header: CallHeader) -> Answer:
        """Answer a ping. Thread: any."""
        received_s, second = REAL_TIME.now(), self._robot.clock.of_real(1.0)
        fields = {
            **self._state_fields(header),
            "mailboxes": {  # their lengths and ages in real seconds
                name: [waiting.count, waiting.oldest_s / second]
                for name, handle in self._robot.items()
                if (waiting := handle.waiting) is not None and waiting.count
            },
            "restarts": dict(self._robot.restarts),
            "resources": len(self._robot),
        }
        return {**fields, "received_s": received_s, "replied_s": REAL_TIME.now()}

    def answer(self, method: str, header: CallHeader) -> Answer:
        """Answer any other method; an error becomes the answer."""
        handlers: dict[str, Callable[[CallHeader], Answer | None]] = {  # those without an answer succeed: 1
            keys.HELLO: self._hello,
            keys.REATTACH: self._reattach,
            keys.CANCEL: self._cancel,
            keys.LEAVE: lambda header: self.disconnect(header.client),
            keys.REVOKE: lambda header: self._host.revoke(map(str, header.arguments)),
            keys.MEMORY: lambda header: int(self._memories.open(header.client, header.arguments)),
        }
        handle = handlers[method]
        try:
            answer = handle(header)
            return 1 if answer is None else answer
        except EALError as error:
            return error.at(self._robot.name)
        except Exception as error:  # noqa: BLE001  # arguments of a controller must not crash the server
            return ProtocolError(f"the call is malformed: {error_text(error)}", robot=self._robot.name)

    def _hello(self, header: CallHeader) -> Answer:
        self._admission.enter(header.client, header.epoch)
        if self._robot.state is RobotState.STARTING:
            raise UnavailableError("it is still starting")
        problems = self._robot.problems
        return {
            **self._state_fields(header),
            "problems": [error_text(problem)[:_MAX_TEXT] for problem in problems],
            "left_out": [reason[:_MAX_TEXT] for reason in self._robot.left_out[len(problems) :]],  # after the problems'
            "resources": [handle.info.to_dict() for handle in self._robot.values()],
            "process": self._host.process,
            "rights": encode_rights(self._host.network.security, self._robot.name),
        }

    def _state_fields(self, header: CallHeader) -> dict[str, Any]:
        holders = self._admission.holders()
        return {
            "release": release(),
            "state": self._robot.state.value,
            "stopped": self._robot.stopped_because,
            "holders": {resource: self._admission.names.of(client) for resource, client in holders.items()},
            "holder_ids": {resource: client for resource, client in holders.items() if client == header.client},
            "not_ready": {name: reason[:_MAX_TEXT] for name, reason in self._robot.not_ready.items()},
            "warnings": [
                *certificate_warnings(self._host.network.security, self._robot.name),
                *descriptor_warnings(),
                *self._tokens.warnings(),
            ],
            "running": [command.to_row() for command in self._running.listed()],
        }

    def _reattach(self, header: CallHeader) -> Answer:
        """Classify commands as running or unknown, and publish the outcomes of ended ones again."""
        numbers = [int(number) for number in header.arguments]
        running, unknown = [], []
        # Each once: publishing an outcome costs everybody.
        for epoch, sequence in dict.fromkeys(zip(numbers[::2], numbers[1::2], strict=False)):
            call_id = CallId(header.client, epoch, sequence)
            record = self._admission.recall(call_id)
            if record is None:
                unknown.append([epoch, sequence])
            elif record.is_finished:
                self._publish(RobotEvent("result", REAL_TIME.now(), call_id, record.outcome))
            else:
                running.append([epoch, sequence])
        return {"running": running, "unknown": unknown}

    def _cancel(self, header: CallHeader) -> None:
        epoch, sequence = (int(number) for number in header.arguments)
        self._running.cancel(CallId(header.client, epoch, sequence))

    def release(self, header: CallHeader) -> Answer:
        """End leases of a controller and halt those resources. Thread: any; at once, since a command may follow."""
        for resource in self._admission.leave(header.client, list(map(str, header.arguments))):
            self._robot[resource].halt()
        return 1

    def disconnect(self, client: str) -> None:
        """Disconnect a controller: halt what it commanded and end its leases and streams."""
        self._publisher.leave(client)
        for resource in self._admission.leave(client):
            self._robot[resource].halt()
