"""The key space: where on the network a robot's methods, events and signs of life are found.

    eal/<fleet>/<robot>/<resource>/<method>/<caller>/<client>   a call of a method of a resource
    eal/<fleet>/<robot>/_/<method>/<caller>/<client>            a call of a method of the robot itself
    eal/<fleet>/@answers/<caller>/<client>/<robot>              what a robot answers to a controller
    eal/<fleet>/<robot>/<resource>/stream/<encoding>-<rate>     what a resource streams
    eal/<fleet>/<robot>/_/events                                what happens on a robot
    eal/<fleet>/<robot>/_/alive                                 liveliness token of a robot
    eal/<fleet>/_/heartbeat/<client>                            sign of life of a controller, for every robot

The caller is the name of the controller's certificate, so that access control sees to it that nobody calls in another
one's name, or hears another one's answers; the client is the controller's process. Calls have seven chunks and nothing
else has, and `@answers` is matched by no wildcard: so a process that serves many robots may listen for all their calls
by one expression, `eal/<fleet>/*/*/*/*/*`. The engine compares each message with every expression that has a wildcard,
which for a thousand robots costs more than everything else together.

Every name becomes one chunk of a key. Letters, digits, `_`, `.`, `-` and `~` stand for themselves, everything else is
percent-encoded, so no name can hold what zenoh gives a meaning (`/ * $ # ? @`). There is exactly one key for each
name: another spelling, such as `Son%61r`, is refused, since access control compares keys as they are written.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final, NamedTuple
from urllib.parse import quote, unquote

from eal_actors.errors import ProtocolError
from eal_actors.info import METHODS

ROOT: Final = "eal"
ROBOT: Final = "_"
"""Stands in the place of a resource for the robot itself, of a robot for the fleet; names begin with a letter."""

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
"""Resource: publish its values for a while; begins the keys on which it does."""
RESOURCE_METHODS: Final = (*METHODS, HALT, INFO, STREAM)

ANYBODY: Final = "_"
"""Who calls where the fleet has no security; names of certificates begin with a letter."""
ANSWERS: Final = "@answers"
"""Begins what robots answer; no name is spelt so, and no wildcard matches it."""
EVENTS: Final = "events"
ALIVE: Final = "alive"
HEARTBEAT: Final = "heartbeat"

ALL_ALIVE: Final = f"{ROOT}/*/*/{ROBOT}/{ALIVE}"
"""Key expression of the liveliness tokens of all robots of all fleets."""


def robot_key(fleet: str, robot: str) -> str:
    """Return the key under which everything of a robot lies; with `/**` behind it, the robot's own key expression.

    Raises:
        ProtocolError: a name is empty.
    """
    return f"{ROOT}/{_encode(fleet)}/{_encode(robot)}"


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
def answer_key(call: CallKey) -> str:
    """Return the key on which the robot answers a call."""
    return f"{answers_key(call.fleet, call.caller, call.client)}/{_encode(call.robot)}"


def call_key(key: CallKey) -> str:
    """Return the key of a call.

    Raises:
        ProtocolError: a name is empty.
    """
    return "/".join((ROOT, *map(_encode, key)))


def call_keys(fleet: str, robot: str | None) -> str:
    """Return the key expression of the calls to a robot; to all robots of the fleet if None."""
    return f"{ROOT}/{_encode(fleet)}/{'*' if robot is None else _encode(robot)}/*/*/*/*"


def answers_key(fleet: str, caller: str, client: str) -> str:
    """Return the key under which robots answer a controller."""
    return f"{ROOT}/{_encode(fleet)}/{ANSWERS}/{_encode(caller)}/{_encode(client)}"


def answering_robot(key: str) -> str:
    """Return who answers on a key of answers."""
    return key.rpartition("/")[2]  # names of robots stand as they are


def own_key(fleet: str, robot: str, name: str) -> str:
    """Return the key of a robot's EVENTS, or of its token, ALIVE."""
    return f"{robot_key(fleet, robot)}/{ROBOT}/{name}"


def stream_key(fleet: str, robot: str, resource: str, encoding: str, rate: str) -> str:
    """Return the key on which a robot publishes the values of a resource at a rate in an encoding."""
    return f"{robot_key(fleet, robot)}/{_encode(resource)}/{STREAM}/{_encode(encoding)}-{_encode(rate)}"


def alive_keys(fleet: str) -> str:
    """Return the key expression of the liveliness tokens of all robots of a fleet."""
    return f"{ROOT}/{_encode(fleet)}/*/{ROBOT}/{ALIVE}"


def event_keys(fleet: str) -> str:
    """Return the key expression of the events of all robots of a fleet."""
    return f"{ROOT}/{_encode(fleet)}/*/{ROBOT}/{EVENTS}"


def heartbeat_key(fleet: str, client: str) -> str:
    """Return the key on which a controller shows that it lives."""
    return f"{ROOT}/{_encode(fleet)}/{ROBOT}/{HEARTBEAT}/{_encode(client)}"


def heartbeat_keys(fleet: str) -> str:
    """Return the key expression of the heartbeats of all controllers of a fleet."""
    return f"{ROOT}/{_encode(fleet)}/{ROBOT}/{HEARTBEAT}/*"


def parse_key(key: str) -> tuple[str, str, str, str]:
    """Return the fleet, robot, resource and last name of a key with five chunks.

    Raises:
        ProtocolError: the key is none of this key space, or a name is not spelt as `own_key` does.
    """
    fleet, robot, resource, last = _names(key, 4, "<fleet>/<robot>/<resource>/<name>")
    return fleet, robot, resource, last


@lru_cache(maxsize=4096)
def parse_call(key: str) -> CallKey:
    """Return what the key of a call means.

    Raises:
        ProtocolError: it is none.
    """
    call = CallKey(*_names(key, 6, "<fleet>/<robot>/<resource>/<method>/<caller>/<client>"))
    known = ROBOT_METHODS if call.resource == ROBOT else RESOURCE_METHODS
    if call.robot == ROBOT or call.method not in known:
        raise ProtocolError(f"key {key!r}: there is no method {call.method!r} here; there are {', '.join(known)}")
    return call


def _names(key: str, count: int, form: str) -> list[str]:
    root, *chunks = key.split("/")
    if root != ROOT or len(chunks) != count:
        raise ProtocolError(f"key {key!r} is not {ROOT}/{form}")
    return [_decode(chunk, key) for chunk in chunks]


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
