"""What controllers and robots say to one another: calls, answers, events and heartbeats, before they become bytes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, TypeAlias, final

from eal_actors.device.data import EALData
from eal_actors.kernel.errors import EALError


class CallId(NamedTuple):
    """Which call: unique over all controllers and their restarts.

    Attributes:
        client: 16 hexadecimal digits, new in each process of a controller.
        epoch: how often that client has connected to the robot.
        sequence: number of the call, from 1; each call of the client to the robot has another one.
    """

    client: str
    epoch: int
    sequence: int


class CallHeader(NamedTuple):
    """What a call carries beside its key and its value.

    Attributes:
        client: see CallId.
        epoch: see CallId.
        sequence: see CallId.
        ttl_s: seconds after its receipt within which the robot may begin with it.
        deadline_s: seconds left until the caller's deadline when it was sent; below 0 once it has passed.
        start_s: robot's clock at which to begin, as in its answers, in seconds; None for at once.
        arguments: the method's arguments that are text or int, in their order, of at most 64 bits.
        era: of a command: the run of the robot's server that the echo is from; see receipts.
        echo_s: of a command: the robot's clock as an answer brought it, in seconds.
        held_s: of a command: seconds from that answer to the sending.
        has_more: of a command: the client sends more commands right behind it, to whichever robots; their answers may
            wait a moment for one another.
        traceparent: the span that the call is a part of, as W3C Trace Context writes it; empty where nobody traces.
    """

    client: str
    epoch: int
    sequence: int
    ttl_s: float
    deadline_s: float
    start_s: float | None = None
    arguments: tuple[str | int, ...] = ()
    era: str = ""
    echo_s: float = 0.0
    held_s: float = 0.0
    has_more: bool = False
    traceparent: str = ""

    @property
    def call_id(self) -> CallId:
        """Which call it is."""
        return CallId(self.client, self.epoch, self.sequence)


@final
class Accepted:
    """The answer to a long command: it has begun, its outcome comes as an event."""

    def __repr__(self) -> str:
        return "ACCEPTED"


ACCEPTED: Final = Accepted()

Answer: TypeAlias = int | EALData | EALError | dict[str, Any] | Accepted
"""A status; a value; an error; fields by name (of `hello`, `ping` and `info`); or ACCEPTED."""


@dataclass(frozen=True, slots=True)
class Event:
    """What a robot tells all its controllers.

    Attributes:
        kind: such as `result`; readers pass over kinds that they do not know.
        stamp_s: when it happened, in seconds of the robot's fleet time.
        call: the call it is about, or None.
        answer: the outcome of that call, or None.
        fields: more, by name; plain values.
    """

    kind: str
    stamp_s: float
    call: CallId | None = None
    answer: Answer | None = None
    fields: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """The sign of life of a controller.

    Attributes:
        client: see CallId.
        epoch: see CallId.
        sequence: number of the heartbeat within the epoch.
        name: who it is, for people, such as `anna@lab-pc`.
    """

    client: str
    epoch: int
    sequence: int
    name: str = ""


class Reply(NamedTuple):
    """What comes back for a call.

    Attributes:
        sequence: number of the call; 0 if it could not be read, so that nobody knows which it was.
        answer: the answer.
        time: the robot's clock as it answered, if it came along.
    """

    sequence: int
    answer: Answer
    time: RobotTime | None = None


class ReplyTo(NamedTuple):
    """Who is to be answered.

    Attributes:
        key: on which to answer.
        sequence: see Reply.
        is_urgent: whether the answer goes past everything that waits.
    """

    key: str
    sequence: int
    is_urgent: bool = False


class RobotTime(NamedTuple):
    """A reading of a robot's clock.

    Attributes:
        era: the run of the robot's server.
        time_s: its clock, in seconds.
        began_s: when it began with the command that is answered, by the same clock, where that had a time to begin.
    """

    era: str
    time_s: float
    began_s: float | None = None
