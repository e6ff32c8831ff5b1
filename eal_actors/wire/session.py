"""zenoh configurations of robots, controllers and routers, and sessions that open and close in a bounded time.

A controller dials each robot whose address is an endpoint. Robots with the address `router` dial out to the routers,
and so does their controller: as *clients* of one router at a time, with the others as fallback. As peers they would
receive every message twice from two joined routers, and no message would pass between two peers of one router. A
controller with both kinds of robots is a peer that is linked to the first router only.

A session must not be used on both sides of a fork: start processes with `spawn`. A child opens no session of its own
either once its parent has had one: the engine makes its threads with the first session, and a fork does not copy them.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypeVar

from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.errors import EALError, ProtocolError, UnavailableError
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.memory import limit_heaps, return_buffers
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.keys.revocation import revoked_names, without_revoked
from eal_actors.managers.network_model import BEHIND_ROUTER, DEFAULT_NETWORK, NetworkConfig, parse_endpoint
from eal_actors.wire.engine_exit import IS_A_FORK, close_at_exit, start_thread
from eal_actors.wire.engine_setup import share_threads
from eal_actors.wire.format.packing import MAX_ENVELOPE_BYTES, MAX_PAYLOAD_BYTES
from eal_actors.wire.link_watch import hang_up, watching
from eal_actors.wire.listening import in_use
from eal_actors.wire.own_sockets import Link
from eal_actors.wire.security.accept_guard import ROBOT_STRANGERS, ROUTER_STRANGERS, guarding, raise_file_limit
from eal_actors.wire.security.access import controller_access, robot_access, router_access, tls_config
from eal_actors.wire.security.packet_filter import plain_address

if TYPE_CHECKING:
    import zenoh

T = TypeVar("T")

CLOSE_TIMEOUT_S: Final = 1.0
"""Real seconds after which a session that does not close is abandoned."""

_QUIET_CLOSE_S: Final = 0.05
"""Real seconds in which a session closes that dials nobody."""
_RETRY_S: Final = 0.1
_DIAL_MS: Final = 20
"""Time between two dials of an absent end."""
_TLS_DIAL_MS: Final = 40
"""The same with TLS, where each refused certificate occupies the other end's listener for 0.1 s. A growing period would
spare little, since a few refused ends occupy it anyway; and a restarted robot would be back after up to a second."""
_MAX_DIAL_MS: Final = 1000
_MAX_HANDSHAKES: Final = 2048
"""Simultaneous transport handshakes; fewer strangers that never finish theirs cannot keep others out."""
_HANDSHAKE_MS: Final = 2000
"""Time-out of the engine's handshake over plain links, where it bounds how long strangers occupy a robot."""
_TLS_HANDSHAKE_MS: Final = 20_000
"""Time-out of a TLS handshake, and of the engine's own after it. It is long, because the listener sleeps 0.1 s after
each TLS handshake that fails: while strangers fail faster than that, nobody's is finished in a shorter time. And an
engine's handshake that is cut off near its end leaves a link that is not read (link_watch), as 2 s did on slow boards.
"""
_TLS_OPTIONS: Final = f"#tls_handshake_timeout_ms={_TLS_HANDSHAKE_MS}"
_DIAL_TIMEOUT_MS: Final = 10_000
"""Time-out of a dial, the engine's default."""
_ROUTER_DIAL_TIMEOUT_MS: Final = _HANDSHAKE_MS
"""The same of a router over plain links: only then is the next one dialled, where one is frozen or switched off."""
_MAX_FRAGMENTED_BYTES: Final = MAX_PAYLOAD_BYTES + 2 * MAX_ENVELOPE_BYTES
"""Largest message that a controller or a router puts together of the engine's fragments: an image. Robots take none,
since they receive large calls as parts; see wire.format.parts."""
_MIN_SESSIONS: Final = 1000
_ROBOT_SESSIONS: Final = 256
"""Sessions of controllers with one robot, 37 kB each."""
_STALLED_US: Final = 500_000
"""Time after which a message that waits for a stalled link closes that link, in microseconds."""
_BATCHES: Final = 16
"""Batches of 64 kB of one priority that may wait for a link. With zenoh's default of two, the sender of an image sleeps
between its pieces, and the image takes twice as long. Streams, which are dropped rather than queued, keep two."""
_QUEUE: Final = {"size": {"data": _BATCHES}, "congestion_control": {"block": {"wait_before_close": _STALLED_US}}}
_sessions: Final[set[zenoh.Session]] = set()
"""The open sessions of this process."""
_engine_pids: Final[set[int]] = set()
"""The processes that have opened a session: this one, and those that it is a fork of."""
_SOURCE_PLACE: Final = re.compile(r" at /\S+")
"""Position in zenoh's source, which its errors contain."""


def robot_config(fleet: FleetConfig, robot: str) -> dict[str, Any]:
    """Return the zenoh configuration of a robot; ConfigError if its keys are missing, ValueError without an address."""
    network, entry = fleet.network, fleet.robots[robot]
    if entry.address is None:
        raise ValueError(f"the robot {robot!r} has no address")
    if entry.address == BEHIND_ROUTER:
        config = _config(network, "client", connect=network.routers, sessions=0)
    else:
        config = _config(network, "peer", listen=[entry.listen or entry.address], sessions=0)
    config["transport"]["unicast"]["max_sessions"] = _ROBOT_SESSIONS
    config["transport"]["link"]["rx"] = {"max_message_size": 0}  # no fragments
    if network.security is not None:
        security = without_revoked(network.security)
        config["transport"]["link"]["tls"] = tls_config(security, robot)
        config["access_control"] = robot_access(fleet, security, robot)
    return config


def controller_config(fleet: FleetConfig, robots: Iterable[str] | None = None) -> dict[str, Any]:
    """Return the zenoh configuration of a controller of the remote ones among some robots, or all.

    Raises ConfigError if its keys are missing.
    """
    network = fleet.network
    remote = [name for name in (fleet.robots if robots is None else robots) if fleet.robots[name].address is not None]
    addresses = [address for name in remote if (address := fleet.robots[name].address) is not None]
    direct = list(dict.fromkeys(address for address in addresses if address != BEHIND_ROUTER))
    if BEHIND_ROUTER not in addresses:
        config = _config(network, "peer", connect=direct, sessions=2 * len(direct))
    elif direct:
        config = _config(network, "peer", connect=[network.routers[0], *direct], sessions=2 * len(direct))
    else:
        config = _config(network, "client", connect=network.routers, sessions=0)
    if network.security is not None:
        security = without_revoked(network.security)
        revoked = revoked_names(security.keys)
        config["transport"]["link"]["tls"] = tls_config(security, security.controller)
        config["access_control"] = controller_access(fleet, security, [it for it in remote if it not in revoked])
    return config


def probe_config(endpoint: str, network: NetworkConfig | None = None) -> dict[str, Any]:
    """Return the zenoh configuration of a program that only looks for robots behind a robot's or a router's endpoint.

    It uses the keys of the network, if one is given; ConfigError if they are missing.
    """
    network = network or DEFAULT_NETWORK
    config = _config(network, "client", connect=[endpoint], sessions=0)
    if network.security is not None:
        config["transport"]["link"]["tls"] = tls_config(network.security, network.security.controller)
    return config


def router_config(
    listen: Sequence[str], connect: Sequence[str] = (), fleet: FleetConfig | None = None, name: str = "router"
) -> dict[str, Any]:
    """Return the zenoh configuration of a router; ConfigError if its keys are missing.

    It joins the routers at the endpoints `connect`; unreachable ones are retried. A fleet's network settings and
    security apply, with a certificate of the given name; messages of any fleet pass if None.
    """
    network = DEFAULT_NETWORK if fleet is None else fleet.network
    sessions = 2 * len(fleet.robots) if fleet is not None else 0
    config = _config(network, "router", listen=listen, connect=connect, sessions=sessions)
    if fleet is not None and network.security is not None:
        config["transport"]["link"]["tls"] = tls_config(network.security, name)
        config["access_control"] = router_access(fleet, without_revoked(network.security))
    return config


def endpoints_of(config: dict[str, Any]) -> tuple[str, ...]:
    """Return the endpoints of a configuration: those to listen at, then those to dial."""
    return (*listening_at(config), *config["connect"]["endpoints"])


def listening_at(config: dict[str, Any]) -> tuple[str, ...]:
    """Return the endpoints of a configuration to listen at."""
    return tuple(text.partition("#")[0] for text in config["listen"]["endpoints"])


def _retry(ends: int, protocols: Sequence[str]) -> dict[str, Any]:
    """Return how often absent ends are dialled: at a constant rate, so that a restarted robot is back at once.

    All of them together are dialled at most 500 times a second, or once a second each.
    """
    least_ms = _DIAL_MS if {"tls", "quic"}.isdisjoint(protocols) else _TLS_DIAL_MS
    period_ms = min(max(least_ms, 2 * ends), _MAX_DIAL_MS)
    return {"period_init_ms": period_ms, "period_max_ms": period_ms, "period_increase_factor": 1}


def _config(
    network: NetworkConfig, mode: str, *, listen: Sequence[str] = (), connect: Sequence[str] = (), sessions: int
) -> dict[str, Any]:
    answers = network.discovery and bool(listen)  # controllers, and robots behind routers, cannot be dialled
    protocols = sorted({parse_endpoint(endpoint).protocol for endpoint in (*listen, *connect)})
    is_plain_client = mode == "client" and {"tls", "quic"}.isdisjoint(protocols)
    return {
        "mode": mode,
        # Discovery never connects anything: the fleet file decides what belongs together.
        "scouting": {
            "multicast": {"enabled": answers, "listen": answers, "autoconnect": []},
            "gossip": {"enabled": False},
            "delay": 1,  # ms that opening waits for absent peers
        },
        "listen": {
            "endpoints": [f"{it}{_TLS_OPTIONS if it.startswith('tls/') else ''}" for it in listen],
            "timeout_ms": 0,
            "exit_on_failure": True,
        },
        "connect": {
            "endpoints": list(connect),
            # A client tries each endpoint once and then fails, since it would otherwise wait for the first one only.
            # Peers and routers open at once and dial in the background. Both dial again when a link breaks.
            "timeout_ms": 0 if mode == "client" else -1,
            "exit_on_failure": False,
            "retry": _retry(len(connect), protocols),
        },
        "transport": {
            "shared_memory": {"enabled": False},  # a killed process would leak its segments
            "unicast": {
                "max_sessions": max(_MIN_SESSIONS, sessions),
                "accept_pending": _MAX_HANDSHAKES,
                "accept_timeout": _TLS_HANDSHAKE_MS if protocols == ["tls"] else _HANDSHAKE_MS,
                "open_timeout": _ROUTER_DIAL_TIMEOUT_MS if is_plain_client else _DIAL_TIMEOUT_MS,
                "compression": {"enabled": network.compression},
            },
            "link": {
                "protocols": protocols,
                "tx": {"lease": round(network.lease_s * 1000), "queue": _QUEUE},
                "rx": {"max_message_size": _MAX_FRAGMENTED_BYTES},
            },
        },
    }


def check_process() -> None:
    """Raise UnavailableError if this process is a fork of one that has opened a session. Thread: any."""
    if _engine_pids - {os.getpid()}:
        raise UnavailableError(IS_A_FORK)


@contextmanager
def open_session(
    config: dict[str, Any],
    timeout_s: float = 5.0,
    on_stuck: Callable[[], object] | None = None,
    is_wanted: Callable[[], bool] = lambda: True,
) -> Iterator[zenoh.Session]:
    """Open a session for the length of a `with` block, with a configuration from this module.

    A client waits for the first router that answers. Peers and routers open without waiting; a refused link, for
    example for a missing certificate, shows only as calls without replies. `on_stuck` is called when the engine
    finishes no handshake any more; the session should be opened again then. Raises UnavailableError if the port is in
    use, no router answers, it is no longer wanted, or it took longer than `timeout_s` real seconds and, for each router
    but the last, a dial, or in a fork; and ProtocolError if zenoh does not take the configuration.

    Thread: any; blocks while it opens, and up to CLOSE_TIMEOUT_S while it closes.
    """
    import zenoh

    check_process()
    _engine_pids.add(os.getpid())
    share_threads()
    try:
        checked = zenoh.Config.from_json5(json.dumps(config))
    except zenoh.ZError as error:
        raise ProtocolError(f"zenoh does not take the configuration: {_reason(error)}") from error
    limit_heaps()
    if config["listen"]["endpoints"]:
        raise_file_limit()
        return_buffers()
    with ExitStack() as stack:
        session = _open(checked, config, timeout_s, is_wanted)
        _sessions.add(session)
        stack.callback(_close, session, config)
        most = ROUTER_STRANGERS if config["mode"] == "router" else ROBOT_STRANGERS
        ports = frozenset(parse_endpoint(text).port for text in listening_at(config))
        links = partial(links_of, session)
        stack.enter_context(guarding(ports, most, lambda: [link.peer for link in links() if link.port in ports]))
        stack.enter_context(watching(lambda: set(links()), ports, on_stuck))
        stack.callback(close_at_exit(stack.close))
        yield session


def links_of(session: zenoh.Session) -> Iterator[Link]:
    """Yield the TCP links of a session."""
    for link in session.info.links():
        with contextlib.suppress(ValueError):
            here, there = parse_endpoint(str(link.src)), parse_endpoint(str(link.dst))
            yield Link(here.port, plain_address(there.host), there.port)


def _open(
    checked: zenoh.Config, config: dict[str, Any], timeout_s: float, is_wanted: Callable[[], bool]
) -> zenoh.Session:
    import zenoh

    if config["mode"] == "client":
        timeout_s += (len(config["connect"]["endpoints"]) - 1) * config["transport"]["unicast"]["open_timeout"] / 1000
    end_s = REAL_TIME.now() + timeout_s
    hurry = partial(_hang_up, config)
    while True:
        left_s = max(end_s - REAL_TIME.now(), 0.0)
        try:
            return _in_time(
                lambda: zenoh.open(checked), left_s, "eal-net-open", hurry, discard=_close_now, is_wanted=is_wanted
            )
        except TimeoutError:
            places = ", ".join(endpoints_of(config))
            raise UnavailableError(f"{places}: the network session did not open within {timeout_s:g} s") from None
        except zenoh.ZError as error:
            is_waiting = config["mode"] == "client" and "connect" in str(error)
            if not is_waiting or not is_wanted() or REAL_TIME.now() + _RETRY_S >= end_s:
                raise _open_error(error, config) from error
        REAL_TIME.sleep(_RETRY_S)


def _open_error(error: Exception, config: dict[str, Any]) -> EALError:
    reason = _reason(error)
    failed = next((endpoint for endpoint in endpoints_of(config) if endpoint in reason), None)
    place = failed or ", ".join(endpoints_of(config))
    if "in use" in reason:
        return in_use([failed] if failed else listening_at(config))
    if "assign requested address" in reason:
        return UnavailableError(f"{place}: cannot listen there: this machine has no such address")
    if config["mode"] == "client":
        place = ", ".join(endpoints_of(config))
        return UnavailableError(f"{place}: no router answers there; `eal router` runs one")
    return UnavailableError(f"{place}: the network session cannot be opened: {reason}")


def _reason(error: Exception) -> str:
    return _SOURCE_PLACE.sub("", str(error)).strip()


def _close_now(session: zenoh.Session) -> None:
    session.close()  # type: ignore[no-untyped-call]  # untyped in zenoh's stubs


def _hang_up(config: dict[str, Any], own: Iterable[Link] = ()) -> None:
    """End the handshakes of a session, whose links are `own`; the other sessions of this process keep theirs."""
    others = (link for other in list(_sessions) for link in links_of(other))
    hang_up(config["connect"]["endpoints"], {*own, *others})


def _close(session: zenoh.Session, config: dict[str, Any]) -> None:
    hurry = partial(_hang_up, config, set(links_of(session)))
    _sessions.discard(session)
    try:
        _in_time(lambda: _close_now(session), CLOSE_TIMEOUT_S, "eal-net-close", hurry, hurry_s=_QUIET_CLOSE_S)
    except TimeoutError:
        message = f"the network session did not close within {CLOSE_TIMEOUT_S:g} s and was abandoned"
        get_logger().warning(message, endpoints=endpoints_of(config))


def _in_time(
    work: Callable[[], T],
    timeout_s: float,
    name: str,
    hurry: Callable[[], object],
    *,
    hurry_s: float = math.inf,
    discard: Callable[[T], object] = lambda _: None,
    is_wanted: Callable[[], bool] = lambda: True,
) -> T:
    """Return the result of a call into zenoh that may hang, made in its own thread.

    Raises TimeoutError if it takes longer, or is no longer wanted. `hurry`, which makes the call end soon, is called
    after `hurry_s`, and at the time-out or an interruption; `discard` gets a later result. Thread: blocks the caller.
    """
    outcome: Future[T] = Future()
    waiter = new_waiter()

    def run() -> None:
        try:
            outcome.set_result(work())
        except Exception as error:  # noqa: BLE001  # raised again below
            outcome.set_exception(error)
        REAL_TIME.wake(waiter)

    start_thread(run, name)
    try:
        if hurry_s < timeout_s and not REAL_TIME.wait(waiter, hurry_s):
            hurry()
            timeout_s -= hurry_s
        end_s = REAL_TIME.now() + timeout_s
        while not outcome.done() and is_wanted() and (left_s := end_s - REAL_TIME.now()) > 0:
            REAL_TIME.wait(waiter, min(left_s, _RETRY_S))
        return outcome.result(timeout=0)
    except (TimeoutError, KeyboardInterrupt):
        outcome.add_done_callback(lambda late: discard(late.result()) if late.exception() is None else None)
        hurry()
        raise
