"""Connections of `connect`: robots found by a name or an address, and fleets that connections of one process share.

Programs of the thesis connect to each robot separately. Three such connections must meet in one simulation, so the
first connection to a fleet file opens the fleet, the others use it, and the last one closes it.
"""

from __future__ import annotations

import os
import socket
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eal_actors.actors.handles import RobotHandle
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import FLEET_VARIABLE
from eal_actors.kernel.errors import RobotNotFoundError, UnavailableError, file_error
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.network_model import BEHIND_ROUTER, SECURE_PROTOCOLS, Endpoint, parse_endpoint
from eal_actors.wire.rpc.client.discovery import robots_at

# Robots by name or address.


def find_robot(config: FleetConfig, host: str, port: int) -> str | None:
    """Return the name of a fleet's robot with a name or an address; None if there is none.

    `host` is a robot's name, a host name or IP address, or an endpoint, which has a protocol and a port of its own.
    """
    if host in config.robots:
        return host
    try:
        wanted = _endpoint(host, port)
    except ValueError:
        return None
    for robot in config.robots.values():
        if robot.address is not None and robot.address != BEHIND_ROUTER:
            address = parse_endpoint(robot.address)
            is_same_place = (address.host, address.port) == (wanted.host, wanted.port)
            if is_same_place and ("/" not in host or address.protocol == wanted.protocol):
                return robot.name
    return None


def resolve_endpoint(config: FleetConfig, host: str, port: int) -> str:
    """Return the endpoint of a host and a port that are no robot of the fleet.

    Raises RobotNotFoundError if they are no endpoint, or no machine has that name.
    """
    try:
        endpoint = _endpoint(host, port)
        socket.getaddrinfo(endpoint.host, endpoint.port)  # or the search would last until its time-out
    except OSError as error:
        raise unknown_robot(config, host, port) from error
    except ValueError as error:
        if "/" not in host:
            raise unknown_robot(config, host, port) from error
        raise RobotNotFoundError(f"fleet {config.name!r} has no robot {host!r}, and as an endpoint, {error}") from error
    bracketed = f"[{endpoint.host}]" if ":" in endpoint.host else endpoint.host
    return f"{endpoint.protocol}/{bracketed}:{endpoint.port}"


def _endpoint(host: str, port: int) -> Endpoint:
    if "/" in host:
        return parse_endpoint(host)
    return parse_endpoint(f"tcp/[{host}]:{port}" if ":" in host else f"tcp/{host}:{port}")


def unknown_robot(config: FleetConfig, host: str, port: int) -> RobotNotFoundError:
    """Return the error for a robot that neither the fleet nor the network has."""
    return RobotNotFoundError(
        f"fleet {config.name!r} has no robot {host!r} (port {port}); it has {', '.join(config.robots)}. "
        f"Name another fleet file with `fleet=` or ${FLEET_VARIABLE}, or a machine that serves a robot"
    )


def _remote_fleet(endpoint: str, config: FleetConfig) -> Fleet:
    """Return a fleet, not yet connected, of the one robot at an endpoint. Thread: blocks for a few seconds at most."""
    is_secure = parse_endpoint(endpoint).protocol in SECURE_PROTOCOLS
    security = config.network.security
    if is_secure and security is None:
        raise file_error(config.source, f"{endpoint} needs keys, and this fleet file names none", "network.security")
    try:
        found = robots_at(endpoint, config if is_secure else None)
    except UnavailableError as error:
        raise UnavailableError(f"fleet {config.name!r} has no robot there, and {error.message}") from error
    if len(found) != 1:
        names = ", ".join(robot.robot for robot in found)
        hint = f"leads to {len(found)} robots, {names}: name one in a fleet file" if found else "leads to no robot"
        raise RobotNotFoundError(f"{endpoint} {hint}")
    network: dict[str, Any] = {} if found[0].identity is None else {"identity": found[0].identity}
    if is_secure and security is not None:
        roles = {"controllers": [security.controller], "routers": security.routers}
        keys = security.keys.resolve()
        network["security"] = {"keys": keys, "controller": security.controller, "roles": roles}
    robots = {found[0].robot: {"address": endpoint}}
    content = {"version": 1, "name": found[0].fleet, "robots": robots, "network": network}
    return Fleet(EALConfigManager.of(content, name=endpoint).fleet)


# Shared fleets.


@dataclass
class _SharedFleet:
    fleet: Fleet
    users: int = 0


_lock = threading.Lock()
_fleets: dict[Path | str, _SharedFleet] = {}
_connections_lock = threading.Lock()  # its own: a fleet that connects, or closes, holds the other one for seconds
_connections: Counter[RobotHandle] = Counter()


def _begin_anew() -> None:
    """Forget the fleets of the parent, and its locks: the thread that holds one for seconds is not in the child."""
    global _lock, _connections_lock
    _lock, _connections_lock = threading.Lock(), threading.Lock()
    _fleets.clear()
    _connections.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_begin_anew)


def acquire_fleet(path: Path) -> Fleet:
    """Return the process's connected fleet of a file; each call needs one `release_fleet`.

    Raises ConfigError if the file is invalid. Thread: any; blocks while the fleet connects.
    """
    return _acquire(path.resolve(), lambda: Fleet.load(path))


def acquire_remote_fleet(endpoint: str, config: FleetConfig) -> Fleet:
    """Return the process's connected fleet of the one robot at an endpoint; each call needs one `release_fleet`.

    A secure endpoint such as `tls/robot-1:50000` needs a fleet with keys.

    Raises:
        RobotNotFoundError: several robots are reached there, or none.
        UnavailableError: nobody answers there.
        ConfigError: the keys are missing.

    Thread: any; blocks while the fleet connects.
    """
    return _acquire(endpoint, lambda: _remote_fleet(endpoint, config))


def _acquire(key: Path | str, make: Callable[[], Fleet]) -> Fleet:
    with _lock:
        if key not in _fleets:
            _fleets[key] = _SharedFleet(make().connect())
        shared = _fleets[key]
        shared.users += 1
        return shared.fleet


def release_fleet(fleet: Fleet) -> None:
    """Undo one `acquire_fleet`; the last call closes the fleet. Thread: any; blocks while the fleet closes."""
    with _lock:
        for key, shared in list(_fleets.items()):
            if shared.fleet is fleet:
                shared.users -= 1
                if shared.users == 0:
                    del _fleets[key]
                    fleet.close()


def add_connection(robot: RobotHandle) -> None:
    """Count a connection to a robot; each needs one `remove_connection`. Thread: any."""
    with _connections_lock:
        _connections[robot] += 1


def remove_connection(robot: RobotHandle) -> None:
    """Count the end of a connection; the last one halts the robot. Thread: any; blocks until it has halted."""
    with _connections_lock:
        _connections[robot] -= 1
        is_last = _connections[robot] <= 0
        if is_last:
            del _connections[robot]
    if is_last:
        robot.halt().exception()  # a robot that is out of reach cannot be halted
