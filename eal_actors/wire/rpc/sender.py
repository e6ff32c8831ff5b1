"""Sender: sends messages of many robots one after another in one thread.

A thread per robot would be woken for each message, and a hundred threads would mostly wake one another.

InFlightWindow limits how far calls run ahead of their replies. A process that serves a thousand robots takes their
commands one by one; commands that wait in its socket age, and a command that is too old is refused. So the sender
waits while many calls are unanswered, but only as long as replies arrive: a long command is answered late, and a
frozen robot never answers.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections import deque
from typing import Final

from typing_extensions import override

from eal_actors.actors.actor import EALActor
from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.errors import EALError, error_text
from eal_actors.kernel.log import get_logger

WINDOW: Final = 256
"""Unanswered calls at which the sender waits."""

AT_ONCE: Final = 8
"""Unanswered calls up to which a caller sends by itself; half as many as a link's queue has batches."""

_RESUME_AT: Final = 128
"""Unanswered calls at which it continues: sending many together costs less than one by one."""

PATIENCE_S: Final = 0.05
"""Real seconds without a reply after which the calls in flight count as slow and no longer block the sender."""


class InFlightWindow:
    """Counter of the unanswered calls of one session. Thread: any, except `wait_for_room`."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._in_flight = 0
        self._slow = 0
        self._is_waiting = False
        self._waiter = new_waiter()

    @property
    def has_room_at_once(self) -> bool:
        """Whether so few calls are unanswered that all of them fit into the queue of one link."""
        return self._in_flight < AT_ONCE

    def sent(self) -> None:
        """Count a call that is about to be sent."""
        with self._lock:
            self._in_flight += 1

    def answered(self) -> None:
        """Count a call that is answered or has failed."""
        with self._lock:
            self._in_flight -= 1
            if self._slow > self._in_flight:
                self._slow = self._in_flight
            has_room = self._is_waiting and self._in_flight - self._slow <= _RESUME_AT
        if has_room:
            REAL_TIME.wake(self._waiter)

    def wait_for_room(self) -> None:
        """Wait while too many calls are in flight. Thread: the sender's; blocks as long as replies arrive."""
        if self._in_flight - self._slow < WINDOW:  # the usual case
            return
        self._is_waiting = True
        while (in_flight := self._in_flight) - self._slow > _RESUME_AT:
            if not REAL_TIME.wait(self._waiter, PATIENCE_S) and self._in_flight >= in_flight:
                with self._lock:
                    self._slow = self._in_flight
        self._is_waiting = False


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

        Args:
            is_last: no message waits behind it, so it must not be held back for a batch.

        Thread: one that may wait for a link; blocks while that is full, at most until the engine closes it.
        """


class UrgentMessage(Message):
    """Message that another message's stalled link must not delay."""

    __slots__ = ()

    @abstractmethod
    def bypass(self) -> None:
        """Send it by another thread unless it has been sent. Thread: any; does not block."""


class Sender(EALActor):
    """Sends messages in the order of their submission.

    Args:
        name: name of its thread.
        window: limit of the calls in flight; None for no limit.

    Thread: an actor; any may call `submit`.
    """

    def __init__(self, name: str, window: InFlightWindow | None = None) -> None:
        super().__init__(name, REAL_TIME)
        self._window = window
        self._unsent: deque[Message] = deque()

    @property
    def is_idle(self) -> bool:
        """Whether every submitted message has been sent. Thread: any."""
        return not self._unsent

    def submit(self, message: Message) -> bool:
        """Queue a message; returns False if the sender has ended. Thread: any; does not block."""
        self._unsent.append(message)
        try:
            self.actor_inbox.put_urgent(message, bounded=False)
        except EALError:
            return False
        return True

    @override
    def on_receive(self, message: Message) -> None:
        if self._window is not None:
            self._window.wait_for_room()
        message.send(is_last=self.actor_inbox.empty())
        self._unsent.popleft()

    @override
    def on_crash(self, error: BaseException) -> None:
        get_logger().error("a sender of the network has crashed", actor=self.name, error=error_text(error))
