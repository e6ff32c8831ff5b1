"""What the driver keeps of its talk with a base: orders under way, the lease, and the latest reading."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Protocol

from .messages import Channel, Reply, Request, Welcome, WheelStatus

FIRST_RETRY_S: Final = 0.05
"""After which an order is sent again for the first time."""


class HostSide(Protocol):
    """What turns bytes into replies and requests into bytes."""

    def feed(self, data: bytes) -> list[Reply]:
        """Take bytes and return the replies that have become whole by them."""
        ...

    def encode(self, request: Request) -> bytes:
        """Return a request as bytes."""
        ...

    def reset(self) -> None:
        """Forget what has begun to arrive."""
        ...


class Way(Protocol):
    """What carries the bytes to the base and back, and comes back by itself: a ReopeningPort. Nothing of it waits."""

    @property
    def name(self) -> str:
        """What it goes through, for messages."""
        ...

    @property
    def openings(self) -> int:
        """How often it has been opened; when it changes, the base may be another, or have been off meanwhile."""
        ...

    def why_not_ready(self) -> str | None:
        """Return why it cannot be used at present; None if it can."""
        ...

    def read(self) -> bytes:
        """Return what has arrived; raises NotReadyError."""
        ...

    def write(self, data: bytes) -> int:
        """Send bytes; raises NotReadyError."""
        ...

    def close(self) -> None:
        """Let go of it."""
        ...


@dataclass(frozen=True, slots=True)
class Reading:
    """One status.

    Attributes:
        stamp_s: when it was asked for, in seconds of the fleet's clock.
        wheels: what every status begins with.
        rest: the numbers behind it.
    """

    stamp_s: float
    wheels: WheelStatus
    rest: tuple[int, ...]


@dataclass(eq=False, slots=True)
class Order:
    """An order under way."""

    request: Request
    first_s: float
    next_s: float
    retry_s: float = FIRST_RETRY_S
    tries: int = 1
    reply: Reply | None = None


@dataclass(slots=True)
class Session:
    """What holds as long as a lease does."""

    welcome: Welcome
    opening: int
    polled: int
    tags: dict[Channel, int]
    sent_s: dict[int, float] = field(default_factory=dict)  # polls: when they were sent, by tag
    uptime_ms: int | None = None
