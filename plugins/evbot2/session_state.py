"""The state of a session with a base: its lease, its pending orders and the last reading."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from .messages import (
    CHANNELS,
    TAGS,
    VERSION,
    BaseReply,
    BaseRequest,
    BaseWelcome,
    Code,
    OrderChannel,
    Verb,
    WheelStatus,
)

FIRST_RETRY_S: Final = 0.05
"""Delay of the first retransmission of an order."""


@dataclass(frozen=True, slots=True)
class StatusReading:
    """One status of the base.

    Attributes:
        stamp_s: when it was requested, in seconds of the fleet's clock.
        wheels: the first numbers of every status.
        rest: the numbers after those.
    """

    stamp_s: float
    wheels: WheelStatus
    rest: tuple[int, ...]


@dataclass(eq=False, slots=True)
class PendingOrder:
    """An order that is sent until it is acknowledged."""

    request: BaseRequest
    first_s: float
    next_s: float
    retry_s: float = FIRST_RETRY_S
    tries: int = 1
    reply: BaseReply | None = None


@dataclass(slots=True)
class SessionLease:
    """The state of a lease.

    Attributes:
        welcome: the reply that gave it out.
        opening: of the port, see ReopeningPort.
        polled: the tag of the last poll.
        tags: the tag of the last order, by channel.
        sent_s: when polls were sent, by tag.
        uptime_ms: of the base, in the newest status.
    """

    welcome: BaseWelcome
    opening: int
    polled: int
    tags: dict[OrderChannel, int]
    sent_s: dict[int, float] = field(default_factory=dict)
    uptime_ms: int | None = None

    def request(self, verb: Verb, numbers: tuple[int, ...] = ()) -> BaseRequest:
        """Return a new order, newer than all others of its channel."""
        channel = CHANNELS[verb]
        self.tags[channel] = (self.tags[channel] + 1) % TAGS
        return BaseRequest(verb, self.tags[channel], self.welcome.lease, numbers)


def why_refused(base: str, reply: BaseReply) -> str:
    """Return why a greeting gave no lease, from the reply to it."""
    if reply.code is Code.BUSY:
        return f"{base} is used by another host until that one is silent"
    if reply.code is Code.VERSION:
        return f"{base} does not support version {VERSION} of the protocol"
    return f"{base} answers the greeting with {reply.code.name} and {len(reply.numbers)} numbers"
