"""The messages between host and base, independent of the wire format: requests, replies and their numbers.

A request has a verb, a tag, a lease and whole numbers. A reply has the same verb and tag, a code and whole numbers. The
EvBot II encodes them as lines of text, the EvBot III as binary frames.

- The base assigns a *lease* number in reply to a greeting. The lease ends when no new message arrived for the watchdog
  time: then everything stops, and later requests with its number are refused.
- The *tag* numbers the orders of each channel (wheels, turret) and the polls, each from 1, modulo 65536. An order is
  carried out only if its tag is newer than that of its channel's last order. The last order's tag gets its reply again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum
from types import MappingProxyType
from typing import Final, NamedTuple

VERSION: Final = 1
"""The protocol version, in the greeting and in its reply."""

TAGS: Final = 1 << 16
MAX_NUMBER: Final = (1 << 31) - 1
"""The largest magnitude of a number in a message."""

MAX_NUMBERS: Final = 24
"""The most numbers in a message."""

WATCHDOG_MS: Final = (100, 5000)
"""The allowed watchdog times."""


class Verb(IntEnum):
    """The verb of a request. The name is the word on a text line, the number the byte in a frame."""

    NONE = 0
    """Only in replies: to a request with an unknown verb."""
    HELLO = 1
    """Greet: version, watchdog in ms, number of the host."""
    STAT = 2
    """Poll the status."""
    MOVE = 3
    """Move both wheels from rest to rest in the same time: left in um, right in um, speed of the wheel with the longer
    travel in um/s."""
    VEL = 4
    """Hold wheel speeds: left in um/s, right in um/s, duration in ms."""
    STOP = 5
    """Stop the wheels."""
    SWING = 6
    """Turn the turret: angle in urad, to the left if positive; rate in urad/s."""
    AIM = 7
    """Turn the turret to an angle to the left of straight ahead, in the shorter direction: urad, urad/s."""
    REST = 8
    """Stop the turret."""
    BYE = 9
    """Stop everything, and end the lease."""


class Code(IntEnum):
    """The result of a request. The name is the word on a text line, the number the byte in a frame."""

    OK = 0
    LEASE = 1
    """The lease is invalid or has ended: not carried out; greet again."""
    OLD = 2
    """A newer order was carried out before: not carried out."""
    RANGE = 3
    """A number is out of range: not carried out."""
    VERB = 4
    """The base does not have this verb."""
    ARGS = 5
    """The count of numbers is wrong for the verb."""
    VERSION = 6
    """The base does not support this version."""
    BUSY = 7
    """Another host holds the lease."""


class OrderChannel(Enum):
    """A channel: a group of orders with common tags."""

    WHEELS = "wheels"
    TURRET = "turret"


ARGUMENTS: Final[Mapping[Verb, int]] = MappingProxyType(
    {
        Verb.HELLO: 3,
        Verb.STAT: 0,
        Verb.MOVE: 3,
        Verb.VEL: 3,
        Verb.STOP: 0,
        Verb.SWING: 2,
        Verb.AIM: 2,
        Verb.REST: 0,
        Verb.BYE: 0,
    }
)
"""The count of numbers of each request."""

CHANNELS: Final[Mapping[Verb, OrderChannel]] = MappingProxyType(
    {
        Verb.MOVE: OrderChannel.WHEELS,
        Verb.VEL: OrderChannel.WHEELS,
        Verb.STOP: OrderChannel.WHEELS,
        Verb.SWING: OrderChannel.TURRET,
        Verb.AIM: OrderChannel.TURRET,
        Verb.REST: OrderChannel.TURRET,
    }
)
"""The channel of each order; the other verbs are not orders."""

STOPS: Final[Mapping[OrderChannel, Verb]] = MappingProxyType(
    {OrderChannel.WHEELS: Verb.STOP, OrderChannel.TURRET: Verb.REST}
)
"""The stop order of each channel."""


class State(IntEnum):
    """The state of the last motion of a channel."""

    IDLE = 0
    """There was none since power-up."""
    MOVING = 1
    DONE = 2
    STOPPED = 3
    """Stopped by an order."""
    STALLED = 4
    """Stopped, because its encoders counted nothing."""
    SILENT = 5
    """Stopped by the watchdog."""


@dataclass(frozen=True, slots=True)
class BaseRequest:
    """A message from the host.

    Attributes:
        tag: its number, 0..65535.
        lease: its lease, 1..65535; 0 in a greeting.
        numbers: the arguments of the verb.
    """

    verb: Verb
    tag: int
    lease: int
    numbers: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class BaseReply:
    """A message from the base.

    Attributes:
        verb: the request's.
        tag: the request's.
        numbers: if the code is OK: those of a BaseWelcome after a greeting, else of the make's status.
    """

    verb: Verb
    tag: int
    code: Code
    numbers: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class InvalidRequest:
    """An intact but invalid request; the reply has its code."""

    tag: int
    code: Code


class BaseWelcome(NamedTuple):
    """The reply to a greeting; the newest tags follow, of polls and then of each channel."""

    model: int
    """2 for the EvBot II, 3 for the EvBot III."""
    version: int
    boot: int
    """A new number for each power-up, which resets the encoders to 0."""
    lease: int
    step_um: int
    """Travel of a wheel from one count of its encoder to the next."""
    max_speed_um_s: int
    """Greatest speed of a wheel."""


class WheelStatus(NamedTuple):
    """The first numbers of every status."""

    uptime_ms: int
    """Modulo 2^31: tells which of two replies is older."""
    order: int
    """Tag of the last motion order that was accepted."""
    state: int
    """Its State."""
    left: int
    """Total of the left encoder, forward positive; modulo 2^32, signed."""
    right: int
    strain: int
    """1 while something blocks the motors, else 0."""


def is_newer(tag: int, than: int) -> bool:
    """Return whether a tag comes after another, modulo 65536."""
    return 0 < (tag - than) % TAGS < TAGS // 2
