"""Outbox: sends the replies and events of a session's robots, so that no robot waits for a controller.

`Replies` encodes the outcomes of one robot's calls and passes them on. A reading has a way of its own there, without
the objects in between: it is by far the most frequent call.

Replies to the calls of one batch are sent together as far as they wait together (ReplyBatch): the outbox's thread takes
what has gathered until it runs. Nothing waits for a batch to fill.

Confirmations of stops have a sender of their own, since hundreds of images may wait in the queue.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, NamedTuple, Self

from typing_extensions import override

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.device.data import EALData, Payload
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import BusyError, EALError, ResourceFaultError, error_text
from eal_actors.wire.format.batches import MAX_ROW_BYTES, encode_batch
from eal_actors.wire.format.messages import Answer, RobotTime, encode_reply, encode_status, encode_value
from eal_actors.wire.local_link import LocalLink
from eal_actors.wire.rpc.sender import Sender
from eal_actors.wire.shared_memory import LEAST_BYTES, ControllerMemories, SharedValue
from eal_actors.wire.transport import Transport

_LARGE_BYTES: Final = 32 * 1024
_LARGE_PAUSE_S: Final = 2.0
"""Real seconds after a large payload in which the link may still be full of it."""
_SLOW_PUT_S: Final = 0.0009
"""Real seconds of a put after which a full link may have dropped the message, as it does after 1 ms."""

MAX_BACKLOG_BYTES: Final = 64 * 1024 * 1024
"""Bytes of values that may wait to be sent; while more wait, further values are refused."""


class Outbox(Sender):
    """Sends replies and events; those that wait together are sent as a batch. Thread: an actor.

    `transport` is replaced when the session is. `is_full` is whether so many bytes wait that no further value may be
    queued.
    """

    def __init__(self, name: str, transport: Transport) -> None:
        super().__init__(name)
        self.urgent: Final = Sender(f"{name} for stops")
        self.transport = transport
        self.is_full = False
        self._backlog_bytes = 0
        self._busy_until_s = -math.inf  # as far as is known, a link may be full until then
        self._put_lock = threading.Lock()
        self._lock = threading.Lock()

    @override
    def launch(self) -> Self:
        self.urgent.launch()
        return super().launch()

    @override
    def on_stop(self) -> None:
        self.urgent.end_soon()

    def publish(
        self, key: str, envelope: bytes, payload: Payload, *, is_vital: bool = True, is_urgent: bool = False
    ) -> None:
        """Queue a message; a full link drops it unless it is vital. Thread: any; does not block."""
        if is_urgent:
            self.urgent.submit(partial(self._put, key, envelope, payload, is_vital, is_urgent=True))
        else:
            self._count(memoryview(payload).nbytes)
            self.submit(partial(self.put, key, envelope, payload, is_vital))

    def publish_from_here(self, key: str, envelope: bytes, payload: Payload, *, is_urgent: bool = False) -> None:
        """Send a message, or queue it while another thread is sending. Thread: one that may wait, see Send."""
        if not self._put_here(key, envelope, payload, is_vital=True):
            self.publish(key, envelope, payload, is_urgent=is_urgent)

    def publish_briefly(self, key: str, envelope: bytes, payload: Payload, *, is_urgent: bool = False) -> None:
        """Send a message in this thread if that takes no time, else queue it.

        The thread is an actuator's or the reader's, which no controller may block. So a full link drops the message
        after 1 ms, and a message whose put took so long is sent again by the queue: the other end ignores a second
        reply. Afterwards the engine drops at once until the link has room, but by then that message waits in the queue,
        and further ones go behind it. A router would drop it unnoticed.
        """
        now_s = REAL_TIME.now()
        is_quiet = not (self.unsent or is_urgent or now_s < self._busy_until_s or self.transport.is_relayed)
        is_sent = is_quiet and self._put_here(key, envelope, payload, is_vital=False)
        if not is_sent or REAL_TIME.now() - now_s >= _SLOW_PUT_S:
            self.publish(key, envelope, payload, is_urgent=is_urgent)

    def _put_here(self, key: str, envelope: bytes, payload: Payload, *, is_vital: bool) -> bool:
        """Send a message unless another thread is sending; return whether it was sent."""
        if not self._put_lock.acquire(blocking=False):
            return False
        try:
            self._put(key, envelope, payload, is_vital)
        finally:
            self._put_lock.release()
        return True

    def _count(self, payload_bytes: int) -> None:
        if payload_bytes:  # most messages have none
            with self._lock:
                self._backlog_bytes += payload_bytes
                self.is_full = self._backlog_bytes >= MAX_BACKLOG_BYTES

    def put(self, key: str, envelope: bytes, payload: Payload, is_vital: bool, is_last: bool) -> None:
        """Send a queued message, after the one that is being sent. Thread: see Send."""
        with self._put_lock:
            self._put(key, envelope, payload, is_vital, is_last)
        self._count(-memoryview(payload).nbytes)

    def _put(
        self, key: str, envelope: bytes, payload: Payload, is_vital: bool, is_last: bool = True, is_urgent: bool = False
    ) -> None:
        if len(payload) > _LARGE_BYTES:
            self._busy_until_s = REAL_TIME.now() + _LARGE_PAUSE_S
        self.transport.put(key, envelope, payload, is_urgent=is_urgent, is_last=is_last, is_vital=is_vital)


@dataclass(slots=True, eq=False)
class ReplyBatch:
    """Replies to the calls of one batch, with one key, which an outbox sends."""

    outbox: Outbox
    key: str
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _rows: list[tuple[str, bytes, Payload]] = field(default_factory=list)

    def add(self, robot: str, envelope: bytes, payload: Payload) -> bool:
        """Send a robot's reply with those that wait; return False if it is too large for that. Thread: any."""
        if len(envelope) + len(payload) > MAX_ROW_BYTES:
            return False
        with self._lock:
            self._rows.append((robot, envelope, payload))
            is_first = len(self._rows) == 1
        if is_first:
            self.outbox.submit(self._send)
        return True

    def _send(self, is_last: bool) -> None:
        with self._lock:
            rows, self._rows = self._rows, []
        self.outbox.put(self.key, encode_batch(rows), b"", is_vital=True, is_last=is_last)


class ReplyTo(NamedTuple):
    """Address of a reply; an urgent one overtakes queued messages.

    Replies to the calls of one batch gather in `batch`; None for a call that came alone. `link` is the local link that
    the call came by; None for the engine.
    """

    key: str
    sequence: int
    is_urgent: bool = False
    batch: ReplyBatch | None = None
    link: LocalLink | None = None


class Replies:
    """Replies of one robot, in one run of its server. Thread: any; only `send` may block."""

    def __init__(self, robot: RobotHandle, era: str, outbox: Outbox, memories: ControllerMemories) -> None:
        self._robot = robot.name
        self._clock = robot.clock
        self._era = era
        self._outbox = outbox
        self._memories = memories

    def outcome(self, done: Future[Any]) -> Answer:
        """Return the result of a finished call, with its stamp in real time."""
        value, error = done.outcome
        if error is not None:
            return error if isinstance(error, EALError) else ResourceFaultError(error_text(error))
        if type(value) is EALData and (stamp_s := value.stamp_s) is not None:
            return value.with_meta(stamp_s=self._clock.to_real(stamp_s))
        return 1 if value is None else value

    def answer(
        self,
        reply_to: ReplyTo,
        answer: Answer,
        *,
        began_s: float | None = None,
        send: Callable[..., None] | None = None,
        shared: SharedValue | None = None,
    ) -> None:
        """Reply to a call.

        `began_s` is when a command with a start time began, in real time. A value in shared memory is not sent. `send`
        is how to send it, as Outbox.publish, which is the default.
        """
        if type(answer) is int and began_s is None:  # the usual outcome of a command
            envelope = encode_status(reply_to.sequence, answer, self._era, REAL_TIME.now())
            self._send(reply_to, envelope, b"", send or self._outbox.publish)
            return
        time = tuple.__new__(RobotTime, (self._era, REAL_TIME.now(), began_s))
        if self._outbox.is_full and isinstance(answer, EALData) and shared is None:
            answer = BusyError("too many values wait for the network; read them less often", robot=self._robot)
        try:
            envelope, payload = encode_reply((reply_to.sequence, answer, time), shared)
        except EALError as error:  # too large, for example
            envelope, payload = encode_reply((reply_to.sequence, error.at(self._robot), time))
        self._send(reply_to, envelope, payload, send or self._outbox.publish)

    def _send(self, reply_to: ReplyTo, envelope: bytes, payload: Payload, send: Callable[..., None]) -> None:
        key, _, is_urgent, batch, link = reply_to
        if link is not None and link.send(self._robot, envelope, payload):
            return
        if batch is None or is_urgent or not batch.add(self._robot, envelope, payload):
            send(key, envelope, payload, is_urgent=is_urgent)

    def answer_reading(
        self, reply_to: ReplyTo, client: str, send: Callable[..., None], done: Future[Any], _: object
    ) -> None:
        """Reply to a call that changes nothing; its value may be handed over in shared memory.

        `send` is how to send it, as Outbox.publish. A relay has the last two arguments: the call is done.
        """
        value = done.outcome[0]
        if type(value) is EALData and value.length < LEAST_BYTES and not self._outbox.is_full:  # the usual case
            stamp_s = None if value.stamp_s is None else self._clock.to_real(value.stamp_s)
            try:
                envelope = encode_value(reply_to.sequence, value, stamp_s, self._era, REAL_TIME.now())
            except EALError as error:
                self.answer(reply_to, error.at(self._robot))
            else:
                self._send(reply_to, envelope, value.payload, send)
            return
        answer, shared = self.outcome(done), None
        if type(answer) is EALData and answer.length >= LEAST_BYTES:
            shared = self._memories.put(client, answer.payload)
        self.answer(reply_to, answer, send=send, shared=shared)
