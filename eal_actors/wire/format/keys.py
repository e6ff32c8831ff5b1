"""Key space: the keys of calls, replies, events, streams, liveliness tokens and heartbeats.

    eal/<fleet>/<robot>/<resource>/<method>/<caller>/<client>   call of a method of a resource
    eal/<fleet>/<robot>/_/<method>/<caller>/<client>            call of a method of the robot itself
    eal/<fleet>/@answers/<caller>/<client>/<robot>              replies of a robot to a controller
    eal/<fleet>/@events/<robot>                                 events of a robot
    eal/<fleet>/@streams/<robot>/<resource>/<encoding>/<rate>   values that a resource streams
    eal/<fleet>/@alive/<version>/<robot>                        liveliness token of a robot, and its protocol version
    eal/<fleet>/@servers/<robot>/<process>/<name>               liveliness token of a process that serves it by a router
    eal/<fleet>/@heartbeats/<caller>/<client>                   heartbeat of a controller, for every robot

The fleet is its name; behind a `~` follows its identity, if it has one.

The caller is the name of the controller's certificate, the client a secret of its process. So access control prevents
a controller from calling or sending heartbeats in another one's name, and from reading another one's replies. Robots
publish a client only as its `client_id`, which does not reveal the key. The key of the token is the same in all
versions of the protocol, so that robots of other releases are found and recognised.

Each name is one chunk of a key. Letters, digits, `_`, `.`, `-` and `~` are kept, everything else is percent-encoded,
so no name can contain a character that zenoh interprets (`/ * $ # ? @`). Each name has exactly one key: another
spelling, such as `Son%61r`, is refused, since access control compares keys as text.

Keep the number of chunks below `eal/<fleet>` small: zenoh compares each message with every declaration there. A
thousand tokens or wildcards of as many robots cost half a millisecond per message. Therefore tokens and streams have
branches that no wildcard of calls matches, calls are not declared, and a process that serves many robots subscribes to
the calls of all by one key expression.
"""

from __future__ import annotations

from functools import lru_cache
from hashlib import blake2b
from typing import Final, NamedTuple
from urllib.parse import quote, unquote

from eal_actors.device.info import METHODS
from eal_actors.kernel.errors import ProtocolError
from eal_actors.managers.network_model import IDENTITY_MARK
from eal_actors.wire.format.packing import PROTOCOL_VERSION

ROOT: Final = "eal"
ROBOT: Final = "_"  # replaces the resource for methods of the robot itself; names of resources begin with a letter

HELLO: Final = "hello"
"""Robot: handshake. Returns its release, resources with their information, state, rights and running commands."""
PING: Final = "ping"  # robot: returns its time and state at once
STOP: Final = "stop"  # robot: emergency stop, until RESUME
RESUME: Final = "resume"  # robot: ends an emergency stop
REATTACH: Final = "reattach"  # robot: reports the outcome of earlier commands, now or when they end
CANCEL: Final = "cancel"  # robot: cancels a running command
LEAVE: Final = "leave"  # robot: disconnects a controller; resources that it commanded are halted
RELEASE: Final = "release"  # robot: ends a controller's leases of some resources; what it commanded there is halted
REVOKE: Final = "revoke"  # robot: adds names to its list of revoked certificates; for AUTHORITY_CALLER alone
MEMORY: Final = "memory"  # robot: opens memory that the controller shares, so that large values need no link
ROBOT_METHODS: Final = (HELLO, PING, STOP, RESUME, REATTACH, CANCEL, LEAVE, RELEASE, REVOKE, MEMORY)

HALT: Final = "halt"  # resource: stops motion
STREAM: Final = "stream"  # resource: publishes its values for the time of a lease
RESOURCE_METHODS: Final = (*METHODS, HALT, STREAM)
RETRYABLE_METHODS: Final = frozenset({"get_status", "get_value", "get_config", "send_req"})
"""Methods that change nothing, so that a retry is harmless. `read_comm` consumes bytes and is not one of them. Nor is
`send_req` of a request in free text; see `call_arguments.is_action`."""

COMMANDS: Final = frozenset(METHODS) - RETRYABLE_METHODS
"""Methods that change something, so that each call is carried out once at most."""

ANYBODY: Final = "_"  # caller in a fleet without security; names of certificates begin with a letter
AUTHORITY_CALLER: Final = "~authority"  # caller that has the authority's key; a name that no other can have
ANSWERS: Final = "@answers"
EVENTS: Final = "@events"
STREAMS: Final = "@streams"
ALIVE: Final = "@alive"
SERVERS: Final = "@servers"
HEARTBEATS: Final = "@heartbeats"

_MAX_KEY: Final = 1024
"""Greatest length of a key that is read, since read keys are cached."""

ALL_ALIVE: Final = f"{ROOT}/*/{ALIVE}/*/*"
"""Key expression of the liveliness tokens of all robots of all fleets."""


class CallKey(NamedTuple):
    """Parts of the key of a call.

    Attributes:
        resource: name of the resource; ROBOT for the robot itself.
        caller: name of the caller's certificate; ANYBODY in a fleet without security.
        client: secret of the caller's process; see client_id.
    """

    fleet: str
    robot: str
    resource: str
    method: str
    caller: str
    client: str


class CallRoute(NamedTuple):
    """Where a received call and its reply go; see `client_id`. A reading changes nothing at its resource."""

    call: CallKey
    answer_key: str
    client: str
    is_reading: bool


def fleet_key(fleet: str) -> str:
    """Return the common prefix of a fleet's keys; ProtocolError if the name is empty."""
    return f"{ROOT}/{_encode(fleet)}"


@lru_cache(maxsize=4096)
def call_key(key: CallKey) -> str:
    """Return the key of a call; ProtocolError if a name is empty."""
    return "/".join((ROOT, *map(_encode, key)))


def call_keys(fleet: str, robot: str | None) -> str:
    """Return the key expression of the calls to a robot; to all robots of the fleet if None."""
    return f"{fleet_key(fleet)}/{'*' if robot is None else _encode(robot)}/*/*/*/*"


def revoke_keys(fleet: str) -> str:
    """Return the key expression of the authority's calls that revoke certificates."""
    return f"{fleet_key(fleet)}/*/{ROBOT}/{REVOKE}/{AUTHORITY_CALLER}/*"


def answer_key(fleet: str, caller: str, client: str, robot: str | None) -> str:
    """Return the key of a robot's replies to a controller; the key expression of all robots' if None."""
    return _branch_key(fleet, ANSWERS, caller, client, robot)


def fleet_words(fleet: str) -> str:
    """Return a fleet of a key for people: its name, and its identity if it has one."""
    name, mark, identity = fleet.rpartition(IDENTITY_MARK)
    return f"{name} (identity {identity})" if mark else fleet


def event_key(fleet: str, robot: str | None) -> str:
    """Return the key of a robot's events; the key expression of all of the fleet if None."""
    return _branch_key(fleet, EVENTS, robot)


def stream_key(fleet: str, robot: str, resource: str, encoding: str, rate: str) -> str:
    """Return the key of a stream: a resource, a rate and an encoding."""
    return _branch_key(fleet, STREAMS, robot, resource, encoding, rate)


def alive_key(fleet: str, robot: str | None) -> str:
    """Return the key of a robot's token with our version; the key expression of all robots' of any version if None."""
    return _branch_key(fleet, ALIVE, None if robot is None else str(PROTOCOL_VERSION), robot)


def server_key(fleet: str, robot: str | None, process: str | None, name: str | None) -> str:
    """Return the key of the token of a process that serves a robot; the key expression of all for what is None."""
    return _branch_key(fleet, SERVERS, robot, process, name)


def heartbeat_key(fleet: str, caller: str | None, client: str | None) -> str:
    """Return the key of a controller's heartbeats; the key expression of all of the fleet if both are None."""
    return _branch_key(fleet, HEARTBEATS, caller, client)


@lru_cache(maxsize=4096)
def client_id(caller: str, client: str) -> str:
    """Return the identifier of a controller's process that robots publish: 32 hexadecimal digits.

    The first half identifies the certificate, the second half the process. Neither reveals the client.
    """
    texts = caller, f"{caller}/{client}"
    return "".join(blake2b(text.encode("utf-8", "surrogatepass"), digest_size=8).hexdigest() for text in texts)


def certificate_id(client: str) -> str:
    """Return the part of a `client_id` that all processes with the same certificate share."""
    return client[:16]


def _branch_key(fleet: str, branch: str, *names: str | None) -> str:
    """Return a key of one of the branches with an @; None becomes `*`."""
    return "/".join((fleet_key(fleet), branch, *("*" if name is None else _encode(name) for name in names)))


@lru_cache(maxsize=4096)
def parse_robot(key: str) -> tuple[str, str]:
    """Return the fleet and the robot of the key of a reply, event or token; ProtocolError if a name is malformed."""
    root, _, rest = key.partition("/")
    fleet, _, rest = rest.partition("/")
    if root != ROOT or not rest:
        raise ProtocolError(f"key {key!r} is not {ROOT}/<fleet>/.../<robot>")
    return _decode(fleet, key), _decode(rest.rpartition("/")[2], key)


def parse_alive(key: str) -> tuple[str, str, int]:
    """Return the fleet, the robot and the version of the key of a token; ProtocolError if it is no such key."""
    fleet, version, robot = _names(key, f"{ROOT}/<fleet>/{ALIVE}/<version>/<robot>")
    if not (version.isascii() and version.isdecimal()):
        raise ProtocolError(f"key {key!r}: {version!r} is no version")
    return fleet, robot, int(version)


def parse_server(key: str) -> tuple[str, str, str]:
    """Return robot, process and its name of the key of a server's token; ProtocolError if it is no such key."""
    _, robot, process, name = _names(key, f"{ROOT}/<fleet>/{SERVERS}/<robot>/<process>/<name>")
    return robot, process, name


@lru_cache(maxsize=4096)
def parse_heartbeat(key: str) -> tuple[str, str]:
    """Return the caller and the client of the key of a heartbeat; ProtocolError if it is no such key."""
    _, caller, client = _names(key, f"{ROOT}/<fleet>/{HEARTBEATS}/<caller>/<client>")
    return caller, client


@lru_cache(maxsize=4096)
def parse_route(key: str) -> CallRoute:
    """Return the route of a call by its key; ProtocolError if it is no such key."""
    names = _names(key, f"{ROOT}/<fleet>/<robot>/<resource>/<method>/<caller>/<client>")
    call = _checked_call(CallKey(*names), key)
    fleet, robot, _, _, caller, client = call
    return CallRoute(call, answer_key(fleet, caller, client, robot), client_id(caller, client), _is_reading(call))


@lru_cache(maxsize=4096)
def route_in_batch(key: str, robot: str, resource: str, method: str) -> CallRoute:
    """Return the route of a call in a batch with that key, whose reply goes to the robot of the call alone.

    Raises ProtocolError if there is no such method, or a name is empty.
    """
    fleet, _, _, _, caller, client = parse_route(key).call
    return parse_route(call_key(CallKey(fleet, robot, resource, method, caller, client)))


def _is_reading(call: CallKey) -> bool:
    return call.resource != ROBOT and call.method in RETRYABLE_METHODS


def _checked_call(call: CallKey, key: str) -> CallKey:
    known = ROBOT_METHODS if call.resource == ROBOT else RESOURCE_METHODS
    if call.method not in known:
        raise ProtocolError(f"key {key!r}: there is no method {call.method!r} here; there are {', '.join(known)}")
    return call


def sender_of(key: str) -> str:
    """Return the caller that any key of a call or a heartbeat names, as it is spelt there."""
    return key.rpartition("/")[0].rpartition("/")[2]


def _names(key: str, shape: str) -> list[str]:
    """Return the names of a key at the places `<...>` of its shape; ProtocolError if it has another shape."""
    if len(key) > _MAX_KEY:
        raise ProtocolError(f"a key of {len(key)} characters, more than {_MAX_KEY}")
    chunks, places = key.split("/"), shape.split("/")
    pairs = list(zip(chunks, places, strict=False))
    if len(chunks) != len(places) or any(chunk != place and place[0] != "<" for chunk, place in pairs):
        raise ProtocolError(f"key {key!r} is not {shape}")
    return [_decode(chunk, key) for chunk, place in pairs if place[0] == "<"]


def _encode(name: str) -> str:
    if not name:
        raise ProtocolError("an empty name has no place in a key")
    return quote(name, safe="", errors="surrogatepass")  # file names that are no UTF-8 have lone surrogates


def _decode(chunk: str, key: str) -> str:
    try:
        name = unquote(chunk, errors="surrogatepass")
    except UnicodeDecodeError as error:
        raise ProtocolError(f"key {key!r}: {chunk!r} is no percent-encoded UTF-8") from error
    if not name or quote(name, safe="", errors="surrogatepass") != chunk:
        raise ProtocolError(f"key {key!r}: {chunk!r} is not how a name is spelt in a key")
    return name
