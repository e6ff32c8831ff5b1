"""Sender: sends messages of many robots one after another in one thread.

A thread per robot would be woken for each message, and a hundred threads would mostly wake one another.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

from typing_extensions import override

from eal_actors.actors.actor import EALActor
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError, error_text
from eal_actors.kernel.log import get_logger

Send = Callable[[bool], None]
"""Sends a message; raises nothing. It gets whether the message is the last: then none is behind it, so it must not be
held back for a batch. Thread: one that may wait for a link; blocks while that is full, at most until the engine closes
it."""


class Sender(EALActor):
    """Sends messages in the order of their submission. Thread: an actor; any may submit.

    `unsent` are the messages to come, the one that is being sent first.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name, REAL_TIME)
        self.unsent: Final = deque[Send]()

    def submit(self, send: Send) -> bool:
        """Queue a message; returns False if the sender has ended. Thread: any; does not block."""
        self.unsent.append(send)
        try:
            self.actor_inbox.call_soon(self.send_next)
        except EALError:
            return False
        return True

    def send_next(self) -> None:
        """Send the next message."""
        self.unsent[0](self.actor_inbox.empty())
        self.unsent.popleft()

    @override
    def on_crash(self, error: BaseException) -> None:
        get_logger().error("a sender of the network has crashed", actor=self.name, error=error_text(error))
