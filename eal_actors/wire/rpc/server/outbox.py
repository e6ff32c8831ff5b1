"""Outbox: sends the replies and events of a session's robots, so that no robot waits for a controller.

The replies of many robots that are commanded at once arrive one by one. Sending each on its own costs several times as
much as sending them together, mostly for waking threads. So when a controller announces more commands, the outbox
waits a moment for their replies.

Confirmations of stops have a sender of their own, since hundreds of images may wait in the queue.
"""

from __future__ import annotations

import math
import threading
from dataclasses import KW_ONLY, dataclass
from typing import Final, Self

from typing_extensions import override

from eal_actors.device.data import Payload
from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.wire.rpc.sender import Message, Sender
from eal_actors.wire.transport import Transport

_BATCH_S: Final = 0.003
"""Real seconds that a reply waits for others at most."""

_LARGE_BYTES: Final = 32 * 1024
_QUIET_S: Final = 2.0
"""Real seconds after a large payload in which the link may still be full of it."""

MAX_BACKLOG_BYTES: Final = 64 * 1024 * 1024
"""Bytes of values that may wait to be sent; while more wait, further values are refused."""


class Outbox(Sender):
    """Sends replies and events; those that wait together are sent as a batch.

    Attributes:
        urgent: sends the urgent messages.

    Thread: an actor.
    """

    def __init__(self, name: str, transport: Transport) -> None:
        super().__init__(name)
        self.urgent: Final = Sender(f"{name} for stops")
        self._transport = transport
        self._backlog_bytes = 0
        self._last_large_s = -math.inf
        self._put_lock = threading.Lock()
        self._lock = threading.Lock()
        self._expected = 0
        self._has_more = False
        self._is_gathering = False
        self._batch_complete = new_waiter()
        self._left_in_batch = 0

    @override
    def launch(self) -> Self:
        self.urgent.launch()
        return super().launch()

    @override
    def on_stop(self) -> None:
        self.urgent.end_soon()

    @property
    def is_full(self) -> bool:
        """Whether so many bytes wait that no further value may be queued. Thread: any."""
        return self._backlog_bytes >= MAX_BACKLOG_BYTES

    def move_to(self, transport: Transport) -> None:
        """Send on another session from now on. Thread: any."""
        self._transport = transport

    def expect(self, replies: int, *, has_more: bool | None = None) -> None:
        """Change the number of expected replies.

        Args:
            replies: number to add; may be negative.
            has_more: whether further commands follow at once; None if unknown.

        Thread: any.
        """
        with self._lock:
            self._expected += replies
            if has_more is not None:
                self._has_more = has_more
            is_complete = self._is_gathering and self._expected <= 0 and not self._has_more
        if is_complete:
            REAL_TIME.wake(self._batch_complete)

    def publish(
        self, key: str, envelope: bytes, payload: Payload, *, is_vital: bool = True, is_urgent: bool = False
    ) -> None:
        """Queue a message; a full link drops it unless it is vital. Thread: any; does not block."""
        self._queue(_OutgoingMessage(self, key, envelope, payload, is_vital=is_vital, is_urgent=is_urgent))

    def publish_from_here(self, key: str, envelope: bytes, payload: Payload, *, is_urgent: bool = False) -> None:
        """Send a message in this thread, or queue it if another thread is sending.

        Thread: one that may wait for a link; see Message.send.
        """
        message = _OutgoingMessage(self, key, envelope, payload, is_urgent=is_urgent)
        if self._put_lock.acquire(blocking=False):
            try:
                self._put(message, is_last=True)
            finally:
                self._put_lock.release()
        else:
            self._queue(message)

    def publish_briefly(self, key: str, envelope: bytes, payload: Payload, *, is_urgent: bool = False) -> None:
        """Send the outcome of a command in this thread if that takes no time, else queue it.

        The thread is an actuator's, which no controller may block. So a full link drops the message after 1 ms,
        and the controller asks again; where that is likely, or other outcomes are expected for a batch, it is queued.
        """
        message = _OutgoingMessage(self, key, envelope, payload, is_vital=False, is_urgent=is_urgent)
        is_quiet = self.is_idle and not is_urgent and not self._has_more and self._expected <= 1
        if is_quiet and REAL_TIME.now() - self._last_large_s > _QUIET_S and self._put_lock.acquire(blocking=False):
            try:
                self._put(message, is_last=True)
            finally:
                self._put_lock.release()
        else:
            message.is_vital = True
            self._queue(message)

    def _queue(self, message: _OutgoingMessage) -> None:
        if message.is_urgent:
            self.urgent.submit(message)
        else:
            self._count(memoryview(message.payload).nbytes)
            self.submit(message)

    def _count(self, payload_bytes: int) -> None:
        if payload_bytes:  # most messages have none
            with self._lock:
                self._backlog_bytes += payload_bytes

    @override
    def on_receive(self, message: Message) -> None:
        if self._left_in_batch <= 0:
            with self._lock:
                self._is_gathering = self._has_more
            if self._is_gathering and not REAL_TIME.wait(self._batch_complete, _BATCH_S):
                self._has_more = False  # until another command announces more
            self._is_gathering = False
            self._left_in_batch = len(self.actor_inbox) + 1
        self._left_in_batch -= 1
        super().on_receive(message)

    def put(self, message: _OutgoingMessage, *, is_last: bool) -> None:
        """Send a queued message, after the one that is being sent unless it is urgent. Thread: see Message.send."""
        if message.is_urgent:
            self._put(message, is_last=is_last)
            return
        with self._put_lock:
            self._put(message, is_last=is_last)
        self._count(-memoryview(message.payload).nbytes)

    def _put(self, message: _OutgoingMessage, *, is_last: bool) -> None:
        if len(message.payload) > _LARGE_BYTES:
            self._last_large_s = REAL_TIME.now()
        self._transport.put(
            message.key,
            message.envelope,
            message.payload,
            is_urgent=message.is_urgent,
            is_last=is_last,
            is_vital=message.is_vital,
        )


@dataclass(slots=True, eq=False)
class _OutgoingMessage(Message):
    """Reply or event."""

    outbox: Outbox
    key: str
    envelope: bytes
    payload: Payload
    _: KW_ONLY
    is_vital: bool = True
    is_urgent: bool = False

    @override
    def send(self, *, is_last: bool) -> None:
        self.outbox.put(self, is_last=is_last)
