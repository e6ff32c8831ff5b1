"""Sender: sends what many have to say, one after another, in a thread of its own.

A thread for each robot would be woken for each message, and a hundred of them would mostly wake one another up.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque

from eal_actors.actors.actor import EALActor
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.net.pacing import Pace


class Message(ABC):
    """Something to send; its own envelope in the sender's mailbox."""

    __slots__ = ()

    reply_to = None

    @property
    def message(self) -> Message:
        """See Envelope."""
        return self

    @abstractmethod
    def send(self, *, is_last: bool) -> None:
        """Send it; raises nothing.

        Args:
            is_last: nothing waits behind it, so that it must not be held back to travel together with more.

        Thread: one that may wait for a link; blocks while that is full, at most until the engine gives it up.
        """


class UrgentMessage(Message):
    """Something that must not be held up by whatever another message waits for."""

    __slots__ = ()

    @abstractmethod
    def insist(self) -> None:
        """Have it sent some other way, unless it is sent by now. Thread: any; does not block."""


class Sender(EALActor):
    """Sends messages in the order in which they came.

    Args:
        name: of its thread.
        pace: how far it may run ahead of the answers; None for as far as it likes.

    Thread: an actor; any may call `submit`.
    """

    def __init__(self, name: str, pace: Pace | None = None) -> None:
        super().__init__(name, REAL_TIME)
        self._pace = pace
        self._unsent: deque[Message] = deque()

    @property
    def is_idle(self) -> bool:
        """Whether everything that was submitted is sent. Thread: any."""
        return not self._unsent

    def submit(self, message: Message) -> bool:
        """Have a message sent; returns whether that is still possible. Thread: any; does not block."""
        self._unsent.append(message)
        try:
            self.actor_inbox.put_urgent(message, bounded=False)
        except EALError:
            return False
        return True

    def on_receive(self, message: Message) -> None:
        """Send a message. Thread: the actor's own."""
        if self._pace is not None:
            self._pace.keep()
        message.send(is_last=self.actor_inbox.empty())
        self._unsent.popleft()

    def on_crash(self, error: BaseException) -> None:
        """Say so. Thread: the actor's own."""
        get_logger().error("the network cannot be written to any more", actor=self.name, error=error_text(error))
