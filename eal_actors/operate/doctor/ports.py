"""Checks of the network ports of robots that are served on this machine."""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterable, Iterator
from typing import Final

from eal_actors.managers.fleet_model import RobotConfig
from eal_actors.managers.network_model import BEHIND_ROUTER, Endpoint, parse_endpoint
from eal_actors.operate.doctor.diagnostic import Diagnostic, ok, problem, warning

_AREA: Final = "ports"
_DATAGRAMS: Final = ("udp", "quic")


def is_here(robot: RobotConfig) -> bool:
    """Return whether a robot runs on this machine: in the controller's process, or at an address of the machine."""
    if robot.address is None:
        return True
    return robot.address != BEHIND_ROUTER and _bind_error(parse_endpoint(robot.address), port=0) is None


def check_ports(robots: Iterable[RobotConfig], answering: Iterable[str]) -> Iterator[Diagnostic]:
    """Yield diagnostics of the ports of robots on this machine; robots that answer use their ports themselves."""
    served = set(answering)
    for robot in robots:
        text = robot.listen or robot.address
        if text is None:
            continue
        error = None if robot.name in served else _bind_error(parse_endpoint(text))
        yield judge_port(robot.name, text, is_served=robot.name in served, error=error)


def judge_port(robot: str, endpoint: str, *, is_served: bool, error: OSError | None) -> Diagnostic:
    """Return the diagnostic of a robot's port: it is served, listening there failed, or neither was tried."""
    if is_served:
        return ok(_AREA, f"{robot} is served at {endpoint}")
    if error is None:
        return ok(_AREA, f"{endpoint} is free for {robot}")
    where, port = f"{endpoint} of {robot}", endpoint.rpartition(":")[2]
    if error.errno == errno.EADDRINUSE:
        advice = f"Find the program with: sudo ss -lnptu 'sport = :{port}'; stop it, or give {robot} another port."
        return problem(_AREA, f"{where} is used by a program that does not answer as that robot", advice)
    if error.errno == errno.EACCES:
        return problem(_AREA, f"{where} is reserved for system programs", f"Give {robot} a port of 1024 or more.")
    return warning(_AREA, f"cannot listen at {where}: {error.strerror}", "Correct the address under 'listen'.")


def _bind_error(endpoint: Endpoint, port: int | None = None) -> OSError | None:
    """Return the error of listening at an endpoint, or None. Port 0 tests only whether the host is this machine."""
    kind = socket.SOCK_DGRAM if port == 0 or endpoint.protocol in _DATAGRAMS else socket.SOCK_STREAM
    try:
        family, _, _, _, place = socket.getaddrinfo(endpoint.host, endpoint.port, type=kind)[0]
        with socket.socket(family, kind) as taken:
            if kind == socket.SOCK_STREAM:  # as servers do, to restart while old connections time out
                taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            taken.bind((place[0], place[1] if port is None else port, *place[2:]))
            if kind == socket.SOCK_STREAM:
                taken.listen(1)
    except OSError as error:
        return error
    return None
