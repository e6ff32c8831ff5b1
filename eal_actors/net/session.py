"""Zenoh configurations for the ends of a fleet's network, and sessions that open and close within a bounded time.

A controller dials each robot that has an endpoint as its address. Robots with the address `router` dial out to the
routers, and so does their controller: as *clients* of one router at a time, with the others to fall back on. For
zenoh gives everything twice to a peer that is linked to two joined routers, and nothing passes between two peers
of one router. A controller that needs both ways is a peer, linked to the first router alone.

A session must not be used on both sides of a fork: start processes with `spawn`.
"""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.errors import EALError, ProtocolError, UnavailableError
from eal_actors.kernel.log import get_logger
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.network_model import BEHIND_ROUTER, DEFAULT_NETWORK, NetworkConfig, parse_endpoint
from eal_actors.net.security import controller_access, robot_access, router_access, tls_config

if TYPE_CHECKING:
    import zenoh

T = TypeVar("T")

CLOSE_TIMEOUT_S: Final = 1.0
"""Seconds after which a session that does not close is left to itself."""

_RETRY_S: Final = 0.1
_MOST_GREETING: Final = 2048
"""How many may be in the middle of their greeting; so many strangers who never end it do not keep others out."""
_GREETING_MS: Final = 4000
"""How long a greeting may take, over a slow link too."""
_MIN_SESSIONS: Final = 1000
_STALLED_US: Final = 500_000
"""How long a message may wait for a stalled link before the link is closed, in microseconds."""
_BATCHES: Final = 16
"""Batches of 64 kB of one priority that may wait for a link. With zenoh's two, whoever sends a frame is put to sleep
between its pieces, and the frame takes twice as long. Streams, which are to be dropped rather than wait, keep two."""
_SOURCE_PLACE: Final = re.compile(r" at /\S+")
"""Where in zenoh's own source an error arose."""


def robot_config(fleet: FleetConfig, robot: str) -> dict[str, Any]:
    """Return the zenoh configuration of a robot that has an address.

    Args:
        fleet: the fleet.
        robot: the robot's name.

    Raises:
        ConfigError: its keys are missing.
        ValueError: the robot has no address, so it lives in the controller's process.
    """
    network, entry = fleet.network, fleet.robots[robot]
    if entry.address is None:
        raise ValueError(f"the robot {robot!r} has no address")
    if entry.address == BEHIND_ROUTER:
        config = _config(network, "client", connect=network.routers, sessions=0)
    else:
        config = _config(network, "peer", listen=[entry.listen or entry.address], sessions=0)
    if network.security is not None:
        config["transport"]["link"]["tls"] = tls_config(network.security, robot)
        config["access_control"] = robot_access(fleet, network.security, robot)
    return config


def controller_config(fleet: FleetConfig, robots: Iterable[str] | None = None) -> dict[str, Any]:
    """Return the zenoh configuration of a controller.

    Args:
        fleet: the fleet.
        robots: names of the robots to reach, all if None; those without an address are passed over.

    Raises:
        ConfigError: its keys are missing.
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
        config["transport"]["link"]["tls"] = tls_config(network.security, network.security.controller)
        config["access_control"] = controller_access(fleet, network.security, remote)
    return config


def visitor_config(endpoint: str, network: NetworkConfig | None = None) -> dict[str, Any]:
    """Return the zenoh configuration of somebody who only looks who is behind an endpoint.

    Args:
        endpoint: of a robot or a router.
        network: whose keys to show; none if None.

    Raises:
        ConfigError: the keys are missing.
    """
    network = network or DEFAULT_NETWORK
    config = _config(network, "client", connect=[endpoint], sessions=0)
    if network.security is not None:
        config["transport"]["link"]["tls"] = tls_config(network.security, network.security.controller)
    return config


def router_config(
    listen: Sequence[str], connect: Sequence[str] = (), fleet: FleetConfig | None = None, name: str = "router"
) -> dict[str, Any]:
    """Return the zenoh configuration of a router.

    Args:
        listen: endpoints to listen at.
        connect: endpoints of other routers to join; it goes on trying those that do not answer.
        fleet: whose network and security it keeps to; any fleet's messages pass if None.
        name: of its certificate, where the fleet has security.

    Raises:
        ConfigError: its keys are missing.
    """
    network = DEFAULT_NETWORK if fleet is None else fleet.network
    sessions = 2 * len(fleet.robots) if fleet is not None else 0
    config = _config(network, "router", listen=listen, connect=connect, sessions=sessions)
    if fleet is not None and network.security is not None:
        config["transport"]["link"]["tls"] = tls_config(network.security, name)
        config["access_control"] = router_access(fleet, network.security)
    return config


def endpoints_of(config: dict[str, Any]) -> tuple[str, ...]:
    """Return the endpoints that a configuration names: where it listens, then where it dials."""
    return (*config["listen"]["endpoints"], *config["connect"]["endpoints"])


def _config(
    network: NetworkConfig, mode: str, *, listen: Sequence[str] = (), connect: Sequence[str] = (), sessions: int
) -> dict[str, Any]:
    answers = network.discovery and bool(listen)  # controllers, and robots behind routers, cannot be dialled
    protocols = sorted({parse_endpoint(endpoint).protocol for endpoint in (*listen, *connect)})
    return {
        "mode": mode,
        # Nobody connects because of what was found: the fleet file says who belongs together.
        "scouting": {
            "multicast": {"enabled": answers, "listen": answers, "autoconnect": []},
            "gossip": {"enabled": False},
            "delay": 1,  # ms that opening waits for absent others
        },
        "listen": {"endpoints": list(listen), "timeout_ms": 0, "exit_on_failure": True},
        "connect": {
            "endpoints": list(connect),
            # A client tries each endpoint once and else fails, for it would wait for the first one alone; all others
            # open at once and go on dialling in the background. Once open, both dial again when a link breaks.
            "timeout_ms": 0 if mode == "client" else -1,
            "exit_on_failure": False,
            "retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
        },
        "transport": {
            "shared_memory": {"enabled": False},  # a killed process would leave its segments
            "unicast": {
                "max_sessions": max(_MIN_SESSIONS, sessions),
                "accept_pending": _MOST_GREETING,
                "accept_timeout": _GREETING_MS,
                "compression": {"enabled": network.compression},
            },
            "link": {
                "protocols": protocols,
                "tx": {
                    "lease": round(network.lease_s * 1000),
                    "queue": {
                        "size": {"data": _BATCHES},
                        "congestion_control": {"block": {"wait_before_close": _STALLED_US}},
                    },
                },
            },
        },
    }


@contextmanager
def open_session(config: dict[str, Any], timeout_s: float = 5.0) -> Iterator[zenoh.Session]:
    """Open a session for the length of a `with` block.

    A client waits for the first router that answers. All others open without waiting for anybody; a link that is
    refused, for want of a certificate say, shows only in calls that get no answer.

    Args:
        config: from `robot_config`, `controller_config` or `router_config`.
        timeout_s: real seconds that opening may take.

    Raises:
        UnavailableError: the port is in use, no router answers, or it took too long.
        ProtocolError: zenoh does not take the configuration.

    Thread: any; blocks while it opens, and up to CLOSE_TIMEOUT_S while it closes.
    """
    import zenoh

    try:
        checked = zenoh.Config.from_json5(json.dumps(config))
    except zenoh.ZError as error:
        raise ProtocolError(f"zenoh does not take the configuration: {_reason(error)}") from error
    session = _open(checked, config, timeout_s)
    try:
        yield session
    finally:
        _close(session, config)


def _open(checked: zenoh.Config, config: dict[str, Any], timeout_s: float) -> zenoh.Session:
    import zenoh

    end_s = REAL_TIME.now() + timeout_s
    while True:
        opening = _Errand(lambda: zenoh.open(checked), "eal-net-open", unwanted=_close_now)
        try:
            return opening.result(max(end_s - REAL_TIME.now(), 0.0))
        except TimeoutError:
            places = ", ".join(endpoints_of(config))
            raise UnavailableError(f"{places}: the network session did not open within {timeout_s:g} s") from None
        except zenoh.ZError as error:
            is_waiting = config["mode"] == "client" and "connect" in str(error)
            if not is_waiting or REAL_TIME.now() + _RETRY_S >= end_s:
                raise _why_not_open(error, config) from error
        REAL_TIME.sleep(_RETRY_S)


def _why_not_open(error: Exception, config: dict[str, Any]) -> EALError:
    reason = _reason(error)
    culprit = next((endpoint for endpoint in config["listen"]["endpoints"] if endpoint in reason), None)
    place = culprit or ", ".join(endpoints_of(config))
    if "in use" in reason:
        return UnavailableError(f"{place}: cannot listen there, for the port is in use by another program")
    if "assign requested address" in reason:
        return UnavailableError(f"{place}: cannot listen there, for the address is none of this machine")
    if config["mode"] == "client":
        return UnavailableError(f"{place}: no router answers there; `eal router` runs one")
    return UnavailableError(f"{place}: the network session cannot be opened: {reason}")


def _reason(error: Exception) -> str:
    return _SOURCE_PLACE.sub("", str(error)).strip()


def _close_now(session: zenoh.Session) -> None:
    session.close()  # type: ignore[no-untyped-call]  # zenoh's stubs say nothing of it


def _close(session: zenoh.Session, config: dict[str, Any]) -> None:
    closing = _Errand(lambda: _close_now(session), "eal-net-close")
    try:
        closing.result(CLOSE_TIMEOUT_S)
    except TimeoutError:
        message = f"the network session did not close within {CLOSE_TIMEOUT_S:g} s; it is left to itself"
        get_logger().warning(message, endpoints=endpoints_of(config))


class _Errand(Generic[T]):
    """A call into zenoh that may hang, on a thread of its own.

    Args:
        work: the call.
        name: of the thread.
        unwanted: called with a result that comes when nobody waits for it any more.
    """

    def __init__(self, work: Callable[[], T], name: str, unwanted: Callable[[T], object] | None = None) -> None:
        self._work = work
        self._unwanted = unwanted
        self._outcome: Future[T] = Future()
        self._waiter = new_waiter()
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def _run(self) -> None:
        try:
            self._outcome.set_result(self._work())
        except Exception as error:  # noqa: BLE001  # raised again where it is waited for
            self._outcome.set_exception(error)
        REAL_TIME.wake(self._waiter)

    def result(self, timeout_s: float) -> T:
        """Return what the call returned, or raise what it raised; TimeoutError if it takes longer.

        Thread: blocks the caller.
        """
        try:
            REAL_TIME.wait(self._waiter, timeout_s)
            return self._outcome.result(timeout=0)
        except (TimeoutError, KeyboardInterrupt):
            self._outcome.add_done_callback(self._dispose)
            raise

    def _dispose(self, outcome: Future[T]) -> None:
        if self._unwanted is not None and outcome.exception() is None:
            self._unwanted(outcome.result())
