"""What host and base say to each other, whatever carries it: requests, replies and the numbers in them.

A request has a verb, a tag, a lease and whole numbers; a reply has the same verb and tag, a code and whole numbers.
The EvBot II writes them as lines of text, the EvBot III as binary frames.

- The *lease* is a number that the base gives out when it is greeted. It lapses when the base has heard nothing fresh
  for the watchdog time: then everything stops, and no request that names it is carried out any more, however late.
- The *tag* numbers the orders of each channel (wheels, turret) and the polls, each from 1, modulo 65536. An order is
  carried out only if its tag is newer than that of its channel's last; the last one's tag gets its reply once more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum
from types import MappingProxyType
from typing import Final, NamedTuple

VERSION: Final = 1
"""Of the protocol, in the greeting and in its answer."""

TAGS: Final = 1 << 16
MAX_NUMBER: Final = (1 << 31) - 1
"""The largest magnitude of a number in a message."""

MAX_NUMBERS: Final = 24
"""The most numbers in a message."""

WATCHDOG_MS: Final = (100, 5000)
"""What a greeting may ask for."""


class Verb(IntEnum):
    """What a request wants. The name is the word on a text line, the number the byte in a frame."""

    NONE = 0
    """In replies alone: to a request whose verb makes no sense."""
    HELLO = 1
    """Greet: version, watchdog in ms, number of the host."""
    STAT = 2
    """Poll: tell the status."""
    MOVE = 3
    """Have each wheel travel its way, from rest to rest, both in the same time: left in um, right in um, speed of the
    one with the longer way in um/s."""
    VEL = 4
    """Hold wheel speeds: left in um/s, right in um/s, for so many ms."""
    STOP = 5
    """Stop the wheels."""
    SWING = 6
    """Turn the turret: angle in urad, to the left if positive; rate in urad/s."""
    AIM = 7
    """Turn the turret to an angle to the left of straight ahead, the shorter way round: urad, urad/s."""
    REST = 8
    """Stop the turret."""
    BYE = 9
    """Stop everything, and give the lease back."""


class Code(IntEnum):
    """What became of a request. The name is the word on a text line, the number the byte in a frame."""

    OK = 0
    LEASE = 1
    """The lease has lapsed, or is none: nothing was done; greet."""
    OLD = 2
    """A newer order was carried out before: nothing was done."""
    RANGE = 3
    """A number is outside its range: nothing was done."""
    VERB = 4
    """No such verb here."""
    ARGS = 5
    """The verb takes another count of numbers."""
    VERSION = 6
    """The base does not speak this version."""
    BUSY = 7
    """Another host holds the lease."""


class Channel(Enum):
    """What has tags of its own."""

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
"""How many numbers a request has."""

CHANNELS: Final[Mapping[Verb, Channel]] = MappingProxyType(
    {
        Verb.MOVE: Channel.WHEELS,
        Verb.VEL: Channel.WHEELS,
        Verb.STOP: Channel.WHEELS,
        Verb.SWING: Channel.TURRET,
        Verb.AIM: Channel.TURRET,
        Verb.REST: Channel.TURRET,
    }
)
"""To which channel an order goes; the other verbs are no orders."""

STOPS: Final[Mapping[Channel, Verb]] = MappingProxyType({Channel.WHEELS: Verb.STOP, Channel.TURRET: Verb.REST})
"""What stops a channel."""


class State(IntEnum):
    """What became of the last motion of a channel."""

    IDLE = 0
    """There was none since the base was switched on."""
    MOVING = 1
    DONE = 2
    STOPPED = 3
    """It was told to stop."""
    STALLED = 4
    """It was driven, and the encoders counted nothing: it was stopped."""
    SILENT = 5
    """The base heard nothing for the watchdog time: it was stopped."""


@dataclass(frozen=True, slots=True)
class Request:
    """What the host says.

    Attributes:
        verb: what it wants.
        tag: its number, 0..65535.
        lease: the lease it was given, 1..65535; 0 in a greeting.
        numbers: as many as the verb takes.
    """

    verb: Verb
    tag: int
    lease: int
    numbers: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Reply:
    """What the base answers.

    Attributes:
        verb: the request's.
        tag: the request's.
        code: what became of it.
        numbers: if it is OK, those of a Welcome after a greeting, and else of the make's status.
    """

    verb: Verb
    tag: int
    code: Code
    numbers: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Nonsense:
    """A request that arrived whole and still makes no sense: it is answered with its code."""

    tag: int
    code: Code


class Welcome(NamedTuple):
    """The answer to a greeting; behind it stand the newest tags, of polls and then of each channel."""

    model: int
    """2 for the EvBot II, 3 for the EvBot III."""
    version: int
    boot: int
    """Another one each time the base is switched on: then its encoders begin at 0."""
    lease: int
    step_um: int
    """Travel of a wheel from one count of its encoder to the next."""
    max_speed_um_s: int
    """Greatest speed of a wheel."""


class WheelStatus(NamedTuple):
    """What every status begins with."""

    uptime_ms: int
    """Modulo 2^31: of two replies the older one is known by it."""
    order: int
    """Tag of the last motion order that was accepted."""
    state: int
    """A State: what became of it."""
    left: int
    """What the left encoder has counted in all, forward positive; modulo 2^32, signed."""
    right: int
    strain: int
    """1 while the motors strain against something that holds them up, else 0."""


def is_newer(tag: int, than: int) -> bool:
    """Return whether a tag comes after another, modulo 65536."""
    return 0 < (tag - than) % TAGS < TAGS // 2
