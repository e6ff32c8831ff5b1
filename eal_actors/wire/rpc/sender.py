"""Sender: sends messages of many robots one after another in one thread.

A thread per robot would be woken for each message, and a hundred threads would mostly wake one another.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from typing import Final

from typing_extensions import override

from eal_actors.actors.actor import EALActor
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError, error_text
from eal_actors.kernel.log import get_logger


class Message(ABC):
    """Message to send; it is its own envelope in the sender's mailbox."""

    __slots__ = ()

    reply_to = None

    @property
    def message(self) -> Message:
        """The message itself; see Envelope."""
        return self

    @abstractmethod
    def send(self, *, is_last: bool) -> None:
        """Send the message; raises nothing.

        The last one has no message behind it, so it must not be held back for a batch. Thread: one that may wait for a
        link; blocks while that is full, at most until the engine closes it.
        """


class UrgentMessage(Message):
    """Message that another message's stalled link must not delay."""

    __slots__ = ()

    @abstractmethod
    def bypass(self) -> None:
        """Send it by another thread unless it has been sent. Thread: any; does not block."""


class Sender(EALActor):
    """Sends messages in the order of their submission; `unsent` are those to come. Thread: an actor; any may submit."""

    def __init__(self, name: str) -> None:
        super().__init__(name, REAL_TIME)
        self.unsent: Final = deque[Message]()

    def submit(self, message: Message) -> bool:
        """Queue a message; returns False if the sender has ended. Thread: any; does not block."""
        self.unsent.append(message)
        try:
            self.actor_inbox.put_urgent(message, bounded=False)
        except EALError:
            return False
        return True

    @override
    def on_receive(self, message: Message) -> None:
        message.send(is_last=self.actor_inbox.empty())
        self.unsent.popleft()

    @override
    def on_crash(self, error: BaseException) -> None:
        get_logger().error("a sender of the network has crashed", actor=self.name, error=error_text(error))
