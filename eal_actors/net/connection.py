"""What the parts of a connection to a robot, and its controller, know of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from eal_actors.actors.actor import Inbox
from eal_actors.kernel.clock import Clock
from eal_actors.net.pinging import Pinger
from eal_actors.net.wire import Answer, Event, Reply


class Reached(Protocol):
    """A connection, as its controller sees it. Thread: zenoh's, but for `look`; nothing blocks."""

    name: str

    def met(self, version: int) -> None:
        """Take note of the robot's sign of life, and of the version of the protocol that it speaks."""
        ...

    def gone(self, reason: str) -> None:
        """Take note that its sign of life is there no more: it will answer nothing."""
        ...

    def hear_reply(self, reply: Reply) -> None:
        """Take in an answer."""
        ...

    def tell(self, event: Event) -> None:
        """Take in what the robot tells.

        Raises:
            ProtocolError: it makes no sense.
        """
        ...

    def look(self, now_s: float) -> None:
        """Give up what has no time left, by REAL_TIME. Thread: the controller's."""
        ...


class Connection(Protocol):
    """A connection, as its lane sees it. Thread: any; nothing blocks.

    Attributes:
        name: the robot's.
        clock: the fleet's.
        pinger: knows the offset of the robot's clock.
        actor_inbox: has timers, which ring in the connection's thread.
    """

    name: str
    clock: Clock
    pinger: Pinger
    actor_inbox: Inbox

    @property
    def is_ready(self) -> bool:
        """Whether the robot is there, and has let us in."""
        ...

    def soon(self, action: Callable[[], None]) -> None:
        """Run an action in the connection's thread, unless it has ended."""
        ...

    def ask_robot(
        self,
        method: str,
        arguments: tuple[str | int, ...],
        timeout_s: float,
        take: Callable[[Answer], None] = ...,
    ) -> None:
        """Ask the robot itself; what comes of it is told in the connection's thread."""
        ...
