"""Mutual TLS and access control of a fleet, as parts of a zenoh configuration.

Everybody proves by a certificate who they are, and each end of a link checks what the other may send over it: a robot
and a router what a controller or an observer may do, a controller and a router that a robot speaks for itself alone.
What comes by way of a router was checked there. What no rule allows is dropped, so a query that is not allowed ends
without an answer.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, Literal

from eal_actors.errors import ConfigError, Problem
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.network_model import Grant, SecurityConfig
from eal_actors.net.certificates import AUTHORITY, certificate_file, key_file
from eal_actors.net.keys import (
    ALIVE,
    CANCEL,
    EVENTS,
    HELLO,
    INFO,
    LEAVE,
    PING,
    REATTACH,
    RELEASE,
    ROBOT,
    STOP,
    STREAM,
    robot_key,
)

READING_METHODS: Final = ("get_status", "get_value", "send_req", "read_comm", "get_config", INFO)
"""What an observer may do with a resource."""
READING_ROBOT_METHODS: Final = (HELLO, PING)
"""What an observer may do with a robot."""
BASIC_ROBOT_METHODS: Final = (HELLO, PING, REATTACH, STOP, CANCEL, LEAVE, RELEASE)
"""What a controller of single resources may do with a robot; stopping it is for everybody who moves it."""

_ASKING: Final = ("query", "declare_subscriber", "liveliness_query", "declare_liveliness_subscriber")
"""Messages from controllers towards robots, apart from heartbeats."""
_TELLING: Final = ("reply", "put", "delete", "declare_queryable", "liveliness_token")
"""Messages from robots towards controllers."""

_Flow = Literal["ingress", "egress"]


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
        self._all = robot_key(fleet.name, ROBOT).removesuffix(f"/{ROBOT}")
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
        for name in security.routers:
            for flow in ("ingress", "egress"):
                self._allow(name, flow, (*_ASKING, *_TELLING), [f"{self._all}/**"])

    def allow_robot(self, robot: str) -> None:
        """Let a robot be asked everything, and speak for itself."""
        own, beats = [f"{self._all}/{robot}/**"], [f"{self._all}/{ROBOT}/**"]
        self._allow(robot, "egress", _ASKING, [f"{self._all}/**"])
        self._allow(robot, "ingress", _TELLING, own)
        self._allow(robot, "egress", ("put",), beats)
        self._allow(robot, "ingress", ("declare_subscriber",), beats)

    def allow_controller(self, grant: Grant, robots: Sequence[str]) -> None:
        """Let a controller or an observer do with the robots what its grant says; `*` stands for every robot."""
        wide = robots if grant.robots is not None else ("*",)  # so that one query may go to all robots
        keys = [key for robot in wide for key in self._keys(grant, robot)]
        self._allow(grant.name, "ingress", _ASKING, keys)
        self._allow(grant.name, "egress", ("reply", "put", "delete", "liveliness_token"), keys)
        self._allow(grant.name, "egress", ("declare_queryable",), [f"{self._all}/{robot}/**" for robot in robots])
        if grant.role == "controller":
            beats = [f"{self._all}/{ROBOT}/**"]
            self._allow(grant.name, "ingress", ("put",), beats)
            self._allow(grant.name, "egress", ("declare_subscriber",), beats)

    def _keys(self, grant: Grant, robot: str) -> Iterator[str]:
        base = f"{self._all}/{robot}"
        if grant.role == "controller" and grant.resources is None:
            yield f"{base}/**"
            return
        robot_methods = BASIC_ROBOT_METHODS if grant.role == "controller" else READING_ROBOT_METHODS
        for name in (*robot_methods, EVENTS, ALIVE):
            yield f"{base}/{ROBOT}/{name}"
        for resource in grant.resources or ("*",):
            if grant.role == "controller":
                yield f"{base}/{resource}/**"
            else:
                for name in (*READING_METHODS, f"{STREAM}/**"):
                    yield f"{base}/{resource}/{name}"

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


def _text(file: Path) -> str:
    return str(file.resolve())
