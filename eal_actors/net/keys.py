"""The key space: where on the network calls, answers, events, frames and signs of life are found.

    eal/<fleet>/<robot>/<resource>/<method>/<caller>/<client>   a call of a method of a resource
    eal/<fleet>/<robot>/_/<method>/<caller>/<client>            a call of a method of the robot itself
    eal/<fleet>/@answers/<caller>/<client>/<robot>              what a robot answers to a controller
    eal/<fleet>/@events/<robot>                                 what happens on a robot
    eal/<fleet>/@streams/<robot>/<resource>/<encoding>/<rate>   what a resource streams
    eal/<fleet>/@alive/<version>/<robot>                        liveliness token of a robot, and what it speaks
    eal/<fleet>/@heartbeats/<client>                            sign of life of a controller, for every robot

The caller is the name of the controller's certificate, so that access control sees to it that nobody calls in another
one's name, or hears another one's answers; the client is the controller's process. The version is that of the protocol.
The key of the token stays as it is in all versions, so that robots of other releases are seen, and told apart.

Every name becomes one chunk of a key. Letters, digits, `_`, `.`, `-` and `~` stand for themselves, everything else is
percent-encoded, so no name can hold what zenoh gives a meaning (`/ * $ # ? @`). There is exactly one key for each
name: another spelling, such as `Son%61r`, is refused, since access control compares keys as they are written.

Next to `eal/<fleet>` there stand few chunks, for the engine compares each message that comes with all that is declared
there. A thousand tokens or wildcards of as many robots cost it half a millisecond a message; so tokens and streams are
apart, which no wildcard of calls matches, calls are not declared, and who serves many robots listens for all their
calls by one expression.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final, NamedTuple
from urllib.parse import quote, unquote

from eal_actors.device.info import METHODS
from eal_actors.kernel.errors import ProtocolError
from eal_actors.net.packing import PROTOCOL_VERSION

ROOT: Final = "eal"
ROBOT: Final = "_"
"""Stands in the place of a resource for the robot itself; names begin with a letter."""

HELLO: Final = "hello"
"""Robot: its versions, resources with their information, state, and running commands."""
PING: Final = "ping"
"""Robot: its time, at once."""
STOP: Final = "stop"
"""Robot: emergency stop, until RESUME."""
RESUME: Final = "resume"
"""Robot: end an emergency stop."""
REATTACH: Final = "reattach"
"""Robot: follow commands that are running already."""
CANCEL: Final = "cancel"
"""Robot: give up a running command."""
LEAVE: Final = "leave"
"""Robot: a controller goes; what it commanded is halted."""
RELEASE: Final = "release"
"""Robot: a controller lets go of resources; what it commanded there is halted."""
ROBOT_METHODS: Final = (HELLO, PING, STOP, RESUME, REATTACH, CANCEL, LEAVE, RELEASE)

HALT: Final = "halt"
"""Resource: stop what moves."""
INFO: Final = "info"
"""Resource: what it says of itself."""
STREAM: Final = "stream"
"""Resource: publish its values for a while."""
RESOURCE_METHODS: Final = (*METHODS, HALT, INFO, STREAM)


ANYBODY: Final = "_"
"""Who calls where the fleet has no security; names of certificates begin with a letter."""
ANSWERS: Final = "@answers"
EVENTS: Final = "@events"
STREAMS: Final = "@streams"
ALIVE: Final = "@alive"
HEARTBEATS: Final = "@heartbeats"

ALL_ALIVE: Final = f"{ROOT}/*/{ALIVE}/*/*"
"""Key expression of the liveliness tokens of all robots of all fleets."""


def fleet_key(fleet: str) -> str:
    """Return the key under which everything of a fleet lies.

    Raises:
        ProtocolError: the name is empty.
    """
    return f"{ROOT}/{_encode(fleet)}"


class CallKey(NamedTuple):
    """What the key of a call tells.

    Attributes:
        fleet: name of the fleet, any text.
        robot: name of the robot.
        resource: name of the resource; ROBOT for the robot itself.
        method: one of RESOURCE_METHODS or ROBOT_METHODS.
        caller: name of the certificate of who calls; ANYBODY where the fleet has no security.
        client: which process of theirs; see CallId.
    """

    fleet: str
    robot: str
    resource: str
    method: str
    caller: str
    client: str


@lru_cache(maxsize=4096)
def call_key(key: CallKey) -> str:
    """Return the key of a call.

    Raises:
        ProtocolError: a name is empty.
    """
    return "/".join((ROOT, *map(_encode, key)))


def call_keys(fleet: str, robot: str | None) -> str:
    """Return the key expression of the calls to a robot; to all robots of the fleet if None."""
    return f"{fleet_key(fleet)}/{'*' if robot is None else _encode(robot)}/*/*/*/*"


@lru_cache(maxsize=4096)
def answer_key(call: CallKey) -> str:
    """Return the key on which the robot answers a call."""
    return _told_key(call.fleet, ANSWERS, call.caller, call.client, call.robot)


def answer_keys(fleet: str, caller: str, client: str) -> str:
    """Return the key expression of what robots answer to a controller."""
    return _told_key(fleet, ANSWERS, caller, client, None)


def event_key(fleet: str, robot: str) -> str:
    """Return the key of a robot's events."""
    return _told_key(fleet, EVENTS, robot)


def event_keys(fleet: str) -> str:
    """Return the key expression of the events of all robots of a fleet."""
    return _told_key(fleet, EVENTS, None)


def stream_key(fleet: str, robot: str, resource: str, encoding: str, rate: str) -> str:
    """Return the key on which a robot publishes the values of a resource at a rate in an encoding."""
    return _told_key(fleet, STREAMS, robot, resource, encoding, rate)


def alive_key(fleet: str, robot: str) -> str:
    """Return the key of the liveliness token of a robot that speaks our version."""
    return _told_key(fleet, ALIVE, str(PROTOCOL_VERSION), robot)


def alive_keys(fleet: str) -> str:
    """Return the key expression of the liveliness tokens of all robots of a fleet, whatever version they speak."""
    return _told_key(fleet, ALIVE, None, None)


def heartbeat_key(fleet: str, client: str) -> str:
    """Return the key on which a controller shows that it lives."""
    return _told_key(fleet, HEARTBEATS, client)


def heartbeat_keys(fleet: str) -> str:
    """Return the key expression of the heartbeats of all controllers of a fleet."""
    return _told_key(fleet, HEARTBEATS, None)


def _told_key(fleet: str, kind: str, *names: str | None) -> str:
    """Return the key of what is told; None stands for every name, which makes it a key expression."""
    return "/".join((fleet_key(fleet), kind, *("*" if name is None else _encode(name) for name in names)))


@lru_cache(maxsize=4096)
def parse_robot(key: str) -> tuple[str, str]:
    """Return the fleet and the robot of the key of an answer, of events or of a token.

    Raises:
        ProtocolError: a name is not spelt as a key is made, or is missing.
    """
    root, _, rest = key.partition("/")
    fleet, _, rest = rest.partition("/")
    if root != ROOT or not rest:
        raise ProtocolError(f"key {key!r} is not {ROOT}/<fleet>/.../<robot>")
    return _decode(fleet, key), _decode(rest.rpartition("/")[2], key)


def parse_alive(key: str) -> tuple[str, str, int]:
    """Return the fleet and the robot of the key of a token, and the version of the protocol that the robot speaks.

    Raises:
        ProtocolError: it is none.
    """
    fleet, robot = parse_robot(key)
    _, _, *kind, _ = key.split("/")
    if len(kind) != 2 or kind[0] != ALIVE or not (kind[1].isascii() and kind[1].isdecimal()):
        raise ProtocolError(f"key {key!r} is not {ROOT}/<fleet>/{ALIVE}/<version>/<robot>")
    return fleet, robot, int(kind[1])


@lru_cache(maxsize=4096)
def parse_call(key: str) -> CallKey:
    """Return what the key of a call means.

    Raises:
        ProtocolError: it is none.
    """
    root, *chunks = key.split("/")
    if root != ROOT or len(chunks) != 6:
        raise ProtocolError(f"key {key!r} is not {ROOT}/<fleet>/<robot>/<resource>/<method>/<caller>/<client>")
    call = CallKey(*(_decode(chunk, key) for chunk in chunks))
    known = ROBOT_METHODS if call.resource == ROBOT else RESOURCE_METHODS
    if call.method not in known:
        raise ProtocolError(f"key {key!r}: there is no method {call.method!r} here; there are {', '.join(known)}")
    return call


def _encode(name: str) -> str:
    if not name:
        raise ProtocolError("an empty name has no place in a key")
    return quote(name, safe="", errors="surrogatepass")  # file names may hold what is no UTF-8, as lone surrogates


def _decode(chunk: str, key: str) -> str:
    try:
        name = unquote(chunk, errors="surrogatepass")
    except UnicodeDecodeError as error:
        raise ProtocolError(f"key {key!r}: {chunk!r} is no percent-encoded UTF-8") from error
    if not name or quote(name, safe="", errors="surrogatepass") != chunk:
        raise ProtocolError(f"key {key!r}: {chunk!r} is not how a name is spelt in a key")
    return name
