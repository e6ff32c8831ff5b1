"""Outbox: what the servers of a session have to say, so that no robot waits for a controller that does not read.

Where one process serves many robots that are commanded at once, their answers come one by one. To send each by itself
costs several times what sending them together does, most of it for waking threads up. So, when a controller says that
more commands follow, the outbox waits a moment for their answers.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Final

from eal_actors.device.data import Payload
from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.errors import error_text
from eal_actors.kernel.log import get_logger
from eal_actors.net.sender import Message, Sender

if TYPE_CHECKING:
    import zenoh

_GATHER_S: Final = 0.003
"""Real seconds that an answer waits for others at most."""


class Outbox(Sender):
    """Sends answers and events. Those that wait together travel together.

    Args:
        name: of its thread.
        session: an open session, which outlives it.

    Thread: an actor.
    """

    def __init__(self, name: str, session: zenoh.Session) -> None:
        super().__init__(name)
        self._session = session
        self._gate = threading.Lock()
        self._lock = threading.Lock()
        self._expected = 0
        self._has_more = False
        self._is_gathering = False
        self._all_came = new_waiter()
        self._gathered = 0
        self._log = get_logger()

    def expect(self, answers: int, *, has_more: bool | None = None) -> None:
        """Take note of what is to come.

        Args:
            answers: how many more, or fewer.
            has_more: whether further commands follow at once; None where that is not known.

        Thread: any.
        """
        with self._lock:
            self._expected += answers
            if has_more is not None:
                self._has_more = has_more
            is_complete = self._is_gathering and self._expected <= 0 and not self._has_more
        if is_complete:
            REAL_TIME.wake(self._all_came)

    def publish(
        self, key: str, envelope: bytes, payload: Payload, *, is_vital: bool = True, is_urgent: bool = False
    ) -> None:
        """Publish something; what is not vital is dropped where a link is full. Thread: any; does not block."""
        self.submit(_Letter(self, key, envelope, payload, is_vital=is_vital, is_urgent=is_urgent))

    def publish_from_here(self, key: str, envelope: bytes, payload: Payload, *, is_urgent: bool = False) -> None:
        """Publish something: in this thread, unless another one is sending just now.

        Thread: one that may wait for a link; see Message.
        """
        letter = _Letter(self, key, envelope, payload, is_urgent=is_urgent)
        if self._gate.acquire(blocking=False):
            try:
                self._send(letter, is_last=True)
            finally:
                self._gate.release()
        else:
            self.submit(letter)

    def on_receive(self, message: Message) -> None:
        """Send a letter, together with others if some are due. Thread: the actor's own."""
        if self._gathered <= 0:
            with self._lock:
                self._is_gathering = self._has_more
            if self._is_gathering and not REAL_TIME.wait(self._all_came, _GATHER_S):
                self._has_more = False  # until somebody says so again
            self._is_gathering = False
            self._gathered = len(self.actor_inbox) + 1
        self._gathered -= 1
        super().on_receive(message)

    def send(self, letter: _Letter, *, is_last: bool) -> None:
        """Send a letter, after whoever is sending. Thread: see Message."""
        with self._gate:
            self._send(letter, is_last=is_last)

    def _send(self, letter: _Letter, *, is_last: bool) -> None:
        import zenoh

        payload = letter.payload
        congestion = zenoh.CongestionControl
        try:
            self._session.put(
                letter.key,
                payload if type(payload) is bytes else bytes(payload),
                attachment=letter.envelope,
                priority=zenoh.Priority.REAL_TIME if letter.is_urgent else zenoh.Priority.DATA,
                congestion_control=congestion.BLOCK if letter.is_vital else congestion.DROP,
                express=is_last,
            )
        except Exception as error:  # noqa: BLE001  # zenoh's own: the link broke, or the session is being closed
            self._log.debug("a message could not be sent", key=letter.key, reason=error_text(error))


class _Letter(Message):
    """An answer or an event."""

    __slots__ = ("envelope", "is_urgent", "is_vital", "key", "outbox", "payload")

    def __init__(
        self,
        outbox: Outbox,
        key: str,
        envelope: bytes,
        payload: Payload,
        *,
        is_vital: bool = True,
        is_urgent: bool = False,
    ) -> None:
        self.outbox = outbox
        self.key = key
        self.envelope = envelope
        self.payload = payload
        self.is_vital = is_vital
        self.is_urgent = is_urgent

    def send(self, *, is_last: bool) -> None:
        """See Message."""
        self.outbox.send(self, is_last=is_last)
