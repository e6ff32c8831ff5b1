"""Discovery of robots: those behind an endpoint, and those of this network that answer multicast scouting.

Nothing that is found is used by itself: the fleet file decides what belongs together. An answer comes from anybody, so
what is no robot is left out, and the number of answers is limited. Scouting tries no endpoint that needs certificates.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError, ProtocolError, UnavailableError
from eal_actors.kernel.log import get_logger
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.network_model import IDENTITY_MARK, SECURE_PROTOCOLS, parse_endpoint
from eal_actors.wire.format import keys
from eal_actors.wire.session import open_session, probe_config

if TYPE_CHECKING:
    import zenoh

_PROBE_S: Final = 2.0
"""Real seconds to wait for an answer at an endpoint."""


class FoundRobot(NamedTuple):
    """Robot that was found, its fleet's name and identity, and its endpoint or that of a router that leads to it."""

    fleet: str
    robot: str
    endpoint: str
    identity: str | None = None


@dataclass(frozen=True, slots=True)
class Discovery:
    """Result of scouting: the robots, sorted, and endpoints that require certificates or lead to no robot."""

    robots: tuple[FoundRobot, ...]
    closed: tuple[str, ...]


class ForeignRobots:
    """Live robots of other fleets. Thread: any."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._robots: dict[tuple[str, str], None] = {}

    def note(self, fleet: str, robot: str, *, is_alive: bool) -> None:
        """Note that the token of a robot appeared or disappeared."""
        with self._lock:
            if not is_alive:
                self._robots.pop((fleet, robot), None)
            elif len(self._robots) < _MAX_ANSWERS:
                self._robots[fleet, robot] = None

    def describe(self) -> str:
        """Return the first of them for a message; empty if there is none."""
        with self._lock:
            known = list(self._robots)[:_MAX_SHOWN]
        return ", ".join(f"{robot} of {keys.fleet_words(fleet)}" for fleet, robot in known)


_MAX_SHOWN: Final = 3
_TOKENS_S: Final = 1.0
_LOOK_S: Final = 0.1
_MAX_PROBES: Final = 8
_MAX_ANSWERS: Final = 10_000


def robots_at(endpoint: str, fleet: FleetConfig | None = None) -> list[FoundRobot]:
    """Return the robots at an endpoint: one, or all behind a router. Thread: blocks the caller.

    With a fleet, its keys are used and only its robots are returned; else robots of any fleet. Raises UnavailableError
    if nothing answers there within two real seconds, and ConfigError if the fleet's keys are missing.
    """
    network = None if fleet is None else fleet.network
    wanted = keys.ALL_ALIVE if fleet is None else keys.alive_key(fleet.network_name, None)
    try:
        with open_session(probe_config(endpoint, network), _PROBE_S) as session:
            end_s = REAL_TIME.now() + _TOKENS_S
            while True:  # on a busy machine, an answer just after the link was made may be empty
                replies = session.liveliness().get(wanted, timeout=_TOKENS_S)
                found = _robots_of((reply.ok for reply in replies if reply.ok is not None), endpoint)
                if found or REAL_TIME.now() >= end_s:
                    return sorted(found)
                REAL_TIME.sleep(_LOOK_S)
    except UnavailableError as error:
        raise UnavailableError(f"nobody answers at {endpoint}") from error


def _robots_of(tokens: Iterable[zenoh.Sample], endpoint: str) -> set[FoundRobot]:
    found = set()
    for token in tokens:
        try:
            fleet, robot, _ = keys.parse_alive(str(token.key_expr))
        except ProtocolError as error:
            get_logger().debug("something on the network is no robot", reason=error.message)
        else:
            name, mark, identity = fleet.rpartition(IDENTITY_MARK)
            found.add(FoundRobot(name, robot, endpoint, identity) if mark else FoundRobot(fleet, robot, endpoint))
    return found


def discover(timeout_s: float) -> Discovery:
    """Scout by multicast for some real seconds, then probe each endpoint for its robots.

    Thread: blocks the caller, for that time and a few seconds more if many answer.
    """
    nodes = _scout(timeout_s)
    with ThreadPoolExecutor(_MAX_PROBES, "eal-net-probe") as probes:
        outcomes = list(probes.map(_probe, nodes))
    robots = sorted({robot for found in outcomes for robot in found})
    closed = [node[0] for node, found in zip(nodes, outcomes, strict=True) if node and not found]
    return Discovery(tuple(robots), tuple(sorted(closed)))


def _scout(timeout_s: float) -> list[list[str]]:
    """Return the endpoints of each node that answers the multicast."""
    import zenoh

    config = zenoh.Config.from_json5(json.dumps({"scouting": {"multicast": {"enabled": True}}}))
    nodes: dict[str, list[str]] = {}  # by id, since each answers more than once
    with zenoh.scout(zenoh.handlers.FifoChannel(_MAX_ANSWERS), what="peer|router", config=config) as scout:
        REAL_TIME.sleep(timeout_s)
        while (hello := scout.try_recv()) is not None:
            nodes[str(hello.zid)] = list(hello.locators)
    return list(nodes.values())


def _probe(endpoints: list[str]) -> list[FoundRobot]:
    """Return the robots of a node, from its first endpoint that leads to any."""
    for endpoint in endpoints:
        try:
            if parse_endpoint(endpoint).protocol in SECURE_PROTOCOLS:
                continue
            found = robots_at(endpoint)
        except (EALError, ValueError) as error:
            get_logger().debug("an endpoint was not probed", endpoint=endpoint, reason=str(error))
        else:
            if found:
                return found
    return []
