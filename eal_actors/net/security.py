"""Mutual TLS and access control of a fleet, as parts of a zenoh configuration.

Everybody proves by a certificate who they are, and each end of a link checks what the other may send over it: a robot
and a router what a controller or an observer may do, a controller and a router that a robot speaks for itself alone.
What comes by way of a router was checked there. What no rule allows is dropped, so a call that is not allowed is not
answered. The key of a call ends with its caller and that of an answer names whom it is for, so nobody calls in another
one's name or hears another one's answers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, Literal

from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.network_model import Grant, SecurityConfig
from eal_actors.net.certificates import AUTHORITY, certificate_file, key_file
from eal_actors.net.keys import (
    ALIVE,
    ANSWERS,
    CANCEL,
    EVENTS,
    HEARTBEATS,
    HELLO,
    INFO,
    LEAVE,
    PING,
    REATTACH,
    RELEASE,
    ROBOT,
    STOP,
    STREAM,
    STREAMS,
    fleet_key,
)

READING_METHODS: Final = ("get_status", "get_value", "send_req", "read_comm", "get_config", INFO)
"""What an observer may do with a resource."""
READING_ROBOT_METHODS: Final = (HELLO, PING)
"""What an observer may do with a robot."""
BASIC_ROBOT_METHODS: Final = (HELLO, PING, REATTACH, STOP, CANCEL, LEAVE, RELEASE)
"""What a controller of single resources may do with a robot; stopping it is for everybody who moves it."""

_SAY: Final = ("put",)
_LISTEN: Final = ("declare_subscriber",)
_SHOW_LIFE: Final = ("liveliness_token",)
_SEE_LIFE: Final = ("liveliness_query", "declare_liveliness_subscriber")

_Flow = Literal["ingress", "egress"]
_FLOWS: Final[tuple[_Flow, _Flow]] = ("ingress", "egress")


def tls_config(security: SecurityConfig, name: str) -> dict[str, Any]:
    """Return what goes under `transport/link/tls`.

    Args:
        security: where the keys are.
        name: of whose certificate this end shows.

    Raises:
        ConfigError: a file of the keys is missing.
    """
    certificate, key = certificate_file(security.keys, name), key_file(security.keys, name)
    authority = certificate_file(security.keys, AUTHORITY)
    missing = [file for file in (authority, certificate, key) if not file.is_file()]
    if missing:
        hint = "is missing; `eal keys` makes it where the fleet's authority is, and then it is copied here"
        raise ConfigError([Problem(str(file), 0, 0, "", hint) for file in missing])
    return {
        "root_ca_certificate": _text(authority),
        "listen_certificate": _text(certificate),
        "listen_private_key": _text(key),
        "connect_certificate": _text(certificate),
        "connect_private_key": _text(key),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }


def robot_access(fleet: FleetConfig, security: SecurityConfig, robot: str) -> dict[str, Any]:
    """Return the access control of a robot: what controllers, observers and routers may do with it."""
    access = _Access(fleet)
    access.allow_routers(security)
    for grant in security.grants:
        if grant.robots is None or robot in grant.robots:
            access.allow_controller(grant, robots=(robot,))
    return access.config()


def controller_access(fleet: FleetConfig, security: SecurityConfig, robots: Sequence[str]) -> dict[str, Any]:
    """Return the access control of a controller: each robot speaks for itself alone."""
    access = _Access(fleet)
    access.allow_routers(security)
    for robot in robots:
        access.allow_robot(robot)
    return access.config()


def router_access(fleet: FleetConfig, security: SecurityConfig) -> dict[str, Any]:
    """Return the access control of a router, which stands between controllers and robots and checks both."""
    access = _Access(fleet)
    access.allow_routers(security)
    for robot in fleet.robots:
        access.allow_robot(robot)
    for grant in security.grants:
        access.allow_controller(grant, robots=grant.robots or ("*",))
    return access.config()


class _Access:
    """Collects what is allowed at one end of a link, by the name of the certificate at its other end."""

    def __init__(self, fleet: FleetConfig) -> None:
        self._all = fleet_key(fleet.name)
        self._rules: dict[str, list[dict[str, Any]]] = {}

    def config(self) -> dict[str, Any]:
        """Return what goes under `access_control`."""
        return {
            "enabled": True,
            "default_permission": "deny",
            "rules": [rule for rules in self._rules.values() for rule in rules],
            "subjects": [{"id": name, "cert_common_names": [name]} for name in self._rules],
            "policies": [
                {"rules": [rule["id"] for rule in rules], "subjects": [name]} for name, rules in self._rules.items()
            ],
        }

    def allow_routers(self, security: SecurityConfig) -> None:
        """Trust the routers, which have checked what they pass on."""
        kinds = "", f"/{ANSWERS}", f"/{EVENTS}", f"/{STREAMS}", f"/{ALIVE}", f"/{HEARTBEATS}"
        everything = [f"{self._all}{kind}/**" for kind in kinds]
        for name in security.routers:
            for flow in _FLOWS:
                self._allow(name, flow, (*_SAY, *_LISTEN, *_SHOW_LIFE, *_SEE_LIFE), everything)

    def allow_robot(self, robot: str) -> None:
        """Let a robot be called, and speak for itself."""
        calls, heartbeats = f"{self._all}/{robot}/**", f"{self._all}/{HEARTBEATS}/*"
        self._link(robot, "egress", (calls, heartbeats))
        told = f"{ANSWERS}/*/*/{robot}", f"{EVENTS}/{robot}", f"{STREAMS}/{robot}/**"
        heard = f"{ANSWERS}/*/*/*", f"{EVENTS}/*", f"{STREAMS}/**"
        self._link(robot, "ingress", [f"{self._all}/{key}" for key in told], [f"{self._all}/{key}" for key in heard])
        self._allow(robot, "ingress", _SHOW_LIFE, [f"{self._all}/{ALIVE}/*/{robot}"])
        self._allow(robot, "egress", _SEE_LIFE, [f"{self._all}/{ALIVE}/*/*"])

    def allow_controller(self, grant: Grant, robots: Sequence[str]) -> None:
        """Let a controller or an observer do with the robots what its grant says; `*` stands for every robot."""
        name = grant.name
        calls = [f"{self._all}/{robot}/{method}/{name}/*" for robot in robots for method in _methods_of(grant)]
        self._link(name, "ingress", calls, [f"{self._all}/{robot}/**" for robot in robots])
        if grant.role == "controller":
            self._link(name, "ingress", [f"{self._all}/{HEARTBEATS}/*"])
        told = [f"{ANSWERS}/{name}/*/{robot}" for robot in robots]
        told += [f"{EVENTS}/{robot}" for robot in robots]
        told += [f"{STREAMS}/{robot}/{resource}/**" for robot in robots for resource in grant.resources or ("*",)]
        heard = f"{ANSWERS}/{name}/*/*", f"{EVENTS}/*", f"{STREAMS}/**"
        self._link(name, "egress", [f"{self._all}/{key}" for key in told], [f"{self._all}/{key}" for key in heard])
        self._allow(name, "egress", _SHOW_LIFE, [f"{self._all}/{ALIVE}/*/{robot}" for robot in robots])
        self._allow(name, "ingress", _SEE_LIFE, [f"{self._all}/{ALIVE}/*/*"])

    def _link(self, name: str, flow: _Flow, said: Sequence[str], heard: Sequence[str] = ()) -> None:
        """Let be said over a link what is said there, and be listened for at its other end.

        Args:
            name: of the certificate at the other end.
            flow: which way it is said.
            said: key expressions of what is said.
            heard: key expressions within which may be listened; the same if empty. Wider ones let one subscription be
                for all robots, of which each yet says what it may and nothing else.
        """
        self._allow(name, flow, _SAY, said)
        self._allow(name, _FLOWS[flow == "ingress"], _LISTEN, heard or said)

    def _allow(self, name: str, flow: _Flow, messages: Sequence[str], keys: Sequence[str]) -> None:
        rules = self._rules.setdefault(name, [])
        rules.append(
            {
                "id": f"{name}/{len(rules)}",
                "permission": "allow",
                "flows": [flow],
                "messages": list(messages),
                "key_exprs": list(dict.fromkeys(keys)),
            }
        )


def _methods_of(grant: Grant) -> Iterator[str]:
    """Yield what a grant allows to be called, each as `<resource>/<method>`; `*` stands for all."""
    is_controller = grant.role == "controller"
    if is_controller and grant.resources is None:
        yield "*/*"
        return
    for method in BASIC_ROBOT_METHODS if is_controller else READING_ROBOT_METHODS:
        yield f"{ROBOT}/{method}"
    for resource in grant.resources or ("*",):
        for method in ("*",) if is_controller else (*READING_METHODS, STREAM):
            yield f"{resource}/{method}"


def _text(file: Path) -> str:
    return str(file.resolve())
