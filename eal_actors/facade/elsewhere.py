"""Robots that are named by where they are: in a fleet file, or in none at all."""

from __future__ import annotations

import socket
from typing import Any, Final

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError, Problem, RobotNotFoundError, UnavailableError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.network_model import BEHIND_ROUTER, SECURE_PROTOCOLS, Endpoint, parse_endpoint
from eal_actors.net.controller.discovery import robots_at

FLEET_VARIABLE: Final = "EAL_FLEET"
"""The environment variable that names the fleet file of `connect` calls that name none."""


def robot_at(config: FleetConfig, host: str, port: int) -> str | None:
    """Return the robot of a fleet that has a name or an address; None if there is none.

    Args:
        config: the fleet.
        host: a robot's name, a host name or IP address, or an endpoint, whose protocol and port then count.
        port: of the robot's address, where `host` has none.
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
            is_there = (address.host, address.port) == (wanted.host, wanted.port)
            if is_there and ("/" not in host or address.protocol == wanted.protocol):
                return robot.name
    return None


def endpoint_of(config: FleetConfig, host: str, port: int) -> str:
    """Return the endpoint that a host and a port mean, where the fleet has no robot of that name.

    Raises:
        RobotNotFoundError: it is none, or no machine has that name.
    """
    try:
        endpoint = _endpoint(host, port)
        socket.getaddrinfo(endpoint.host, endpoint.port)  # else it would be looked for until the time is up
    except OSError as error:
        raise unknown_robot(config, host, port) from error
    except ValueError as error:
        if "/" not in host:
            raise unknown_robot(config, host, port) from error
        raise RobotNotFoundError(
            f"fleet {config.name!r} knows no robot {host!r}, and as an endpoint, {error}"
        ) from error
    bracketed = f"[{endpoint.host}]" if ":" in endpoint.host else endpoint.host
    return f"{endpoint.protocol}/{bracketed}:{endpoint.port}"


def unknown_robot(config: FleetConfig, host: str, port: int) -> RobotNotFoundError:
    """Return the error for a robot that is nowhere to be found."""
    return RobotNotFoundError(
        f"fleet {config.name!r} knows no robot {host!r} (port {port}); it has {', '.join(config.robots)}. "
        f"Name another fleet file with `fleet=` or ${FLEET_VARIABLE}, or a machine that serves a robot"
    )


def fleet_at(endpoint: str, config: FleetConfig) -> Fleet:
    """Return a fleet of the one robot that is reached at an endpoint, not yet connected.

    Args:
        endpoint: such as `tcp/192.168.1.11:50000`.
        config: the fleet whose keys are shown where the endpoint wants some.

    Raises:
        RobotNotFoundError: several robots are reached there, or none.
        UnavailableError: nobody answers there.
        ConfigError: the keys are missing.

    Thread: blocks the caller, for a few seconds at most.
    """
    is_secure = parse_endpoint(endpoint).protocol in SECURE_PROTOCOLS
    if is_secure and config.network.security is None:
        message = f"{endpoint} wants keys, and this fleet file names none"
        raise ConfigError([Problem(str(config.source), 0, 0, "network.security", message)])
    try:
        found = robots_at(endpoint, config if is_secure else None)
    except UnavailableError as error:
        raise UnavailableError(f"fleet {config.name!r} has no robot there, and {error.message}") from error
    if len(found) != 1:
        names = ", ".join(robot.robot for robot in found)
        hint = f"leads to {len(found)} robots, {names}: name one in a fleet file" if found else "leads to no robot"
        raise RobotNotFoundError(f"{endpoint} {hint}")
    content: dict[str, Any] = {
        "version": 1,
        "name": found[0].fleet,
        "robots": {found[0].robot: {"address": endpoint}},
        "network": _security_of(config) if is_secure else {},
    }
    return Fleet(EALConfigManager.of(content, name=endpoint).fleet)


def _security_of(config: FleetConfig) -> dict[str, Any]:
    security = config.network.security
    if security is None:
        return {}
    roles = {"controllers": [security.controller], "routers": security.routers}
    keys = security.keys.resolve()
    return {"security": {"keys": keys, "controller": security.controller, "roles": roles}}


def _endpoint(host: str, port: int) -> Endpoint:
    if "/" in host:
        return parse_endpoint(host)
    return parse_endpoint(f"tcp/[{host}]:{port}" if ":" in host else f"tcp/{host}:{port}")
