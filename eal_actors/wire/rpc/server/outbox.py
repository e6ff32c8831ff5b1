"""Outbox: sends the replies and events of a session's robots, so that no robot waits for a controller.

Replies to the calls of one batch are sent together as far as they wait together (ReplyBatch): the outbox's thread takes
what has gathered until it runs. Nothing waits for a batch to fill.

Confirmations of stops have a sender of their own, since hundreds of images may wait in the queue.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, field
from functools import partial
from typing import Final, Self

from typing_extensions import override

from eal_actors.device.data import Payload
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.wire.format.batches import MAX_ROW_BYTES, encode_batch
from eal_actors.wire.rpc.sender import Sender
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
            self.urgent.submit(partial(self._put, key, envelope, payload, is_vital, True))
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
            self._put(key, envelope, payload, is_vital, False, is_last)
        self._count(-memoryview(payload).nbytes)

    def _put(
        self, key: str, envelope: bytes, payload: Payload, is_vital: bool, is_urgent: bool = False, is_last: bool = True
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
        self.outbox.put(self.key, encode_batch(rows), b"", True, is_last)
