"""Mutual TLS and access control: zenoh's configuration, and the same grants as a controller checks them.

Each end of a link proves its identity by a certificate, and each end checks the messages of the other. A robot and a
router restrict controllers and observers; a controller and a router allow a robot only its own keys. Messages from a
router were checked there and are trusted. zenoh drops messages that no rule allows, so a forbidden call gets no reply.

A robot also sends its grants in the handshake (`encode_rights`), so that a controller fails forbidden calls at once
(`Rights`). The robot's own access control remains authoritative.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final, Literal, Self

from eal_actors.kernel.errors import AccessDeniedError, ProtocolError
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.keys.certificates import check_keys, files_of
from eal_actors.managers.keys.revocation import revoked_names
from eal_actors.managers.network_model import Grant, SecurityConfig
from eal_actors.wire.format import keys

OBSERVER_METHODS: Final = ("get_status", "get_value", "send_req", "get_config")
"""Methods of a resource that an observer may call. `read_comm` takes the bytes from who waits for them."""
OBSERVER_ROBOT_METHODS: Final = (keys.HELLO, keys.PING, keys.MEMORY)
"""Methods of a robot that an observer may call."""
LIMITED_ROBOT_METHODS: Final = (
    *OBSERVER_ROBOT_METHODS,
    keys.REATTACH,
    keys.STOP,
    keys.CANCEL,
    keys.LEAVE,
    keys.RELEASE,
)
"""Methods of a robot that a controller of single resources may call; who moves a robot may stop it."""

_PUBLISH: Final = ("put",)
_SUBSCRIBE: Final = ("declare_subscriber",)
_DECLARE_TOKEN: Final = ("liveliness_token",)
_WATCH_TOKENS: Final = ("liveliness_query", "declare_liveliness_subscriber")

_Flow = Literal["ingress", "egress"]
_FLOWS: Final[tuple[_Flow, _Flow]] = ("ingress", "egress")


def tls_config(security: SecurityConfig, name: str) -> dict[str, Any]:
    """Return the section `transport/link/tls` for this end's certificate; ConfigError if a file of it is of no use."""
    check_keys(security.keys, name)
    ca, pem, secret = (str(file.resolve()) for file in files_of(security.keys, name))
    return {
        "root_ca_certificate": ca,
        "listen_certificate": pem,
        "listen_private_key": secret,
        "connect_certificate": pem,
        "connect_private_key": secret,
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }


def robot_access(fleet: FleetConfig, security: SecurityConfig, robot: str) -> dict[str, Any]:
    """Return the access control of a robot: the grants of controllers and observers."""
    rules = _AccessRules(fleet, security)
    rules.allow_authority((robot,))
    for grant in security.grants:
        if grant.robots is None or robot in grant.robots:
            rules.allow_controller(grant, robots=(robot,))
    return rules.config()


def controller_access(fleet: FleetConfig, security: SecurityConfig, robots: Sequence[str]) -> dict[str, Any]:
    """Return the access control of a controller: each robot publishes under its own name only."""
    rules = _AccessRules(fleet, security)
    for robot in robots:
        rules.allow_robot(robot)
    return rules.config()


def router_access(fleet: FleetConfig, security: SecurityConfig) -> dict[str, Any]:
    """Return the access control of a router, which checks controllers and robots."""
    rules = _AccessRules(fleet, security)
    rules.allow_authority(("*",))
    revoked = revoked_names(security.keys)
    for robot in fleet.robots:
        if robot not in revoked:
            rules.allow_robot(robot)
    for grant in security.grants:
        rules.allow_controller(grant, robots=grant.robots or ("*",))
    return rules.config()


class _AccessRules:
    """Rules of one end of a link, by the other end's certificate; routers are trusted, and check what they forward."""

    def __init__(self, fleet: FleetConfig, security: SecurityConfig) -> None:
        self._all = keys.fleet_key(fleet.network_name)
        self._rules: dict[str, list[dict[str, Any]]] = {}
        branches = keys.ANSWERS, keys.EVENTS, keys.STREAMS, keys.ALIVE, keys.SERVERS, keys.HEARTBEATS
        everything = [f"{self._all}/**", *(f"{self._all}/{branch}/**" for branch in branches)]
        for name in security.routers:
            for flow in _FLOWS:
                self._allow(name, flow, (*_PUBLISH, *_SUBSCRIBE, *_DECLARE_TOKEN, *_WATCH_TOKENS), everything)

    def config(self) -> dict[str, Any]:
        return {
            "enabled": True,
            "default_permission": "deny",
            "rules": [rule for rules in self._rules.values() for rule in rules],
            "subjects": [{"id": name, "cert_common_names": [name]} for name in self._rules],
            "policies": [
                {"rules": [rule["id"] for rule in rules], "subjects": [name]} for name, rules in self._rules.items()
            ],
        }

    def allow_robot(self, robot: str) -> None:
        """Allow calls to a robot, what it publishes under its own name, and to see which processes serve it."""
        self._link(robot, "egress", (f"{robot}/**", f"{keys.HEARTBEATS}/*/*"))
        published = f"{keys.ANSWERS}/*/*/{robot}", f"{keys.EVENTS}/{robot}", f"{keys.STREAMS}/{robot}/**"
        self._link(robot, "ingress", published, (f"{keys.ANSWERS}/*/*/*", f"{keys.EVENTS}/*", f"{keys.STREAMS}/**"))
        servers = f"{self._all}/{keys.SERVERS}/{robot}/*/*"
        self._allow(robot, "ingress", _DECLARE_TOKEN, [f"{self._all}/{keys.ALIVE}/*/{robot}", servers])
        self._allow(robot, "ingress", _WATCH_TOKENS, [servers])
        self._allow(robot, "egress", _DECLARE_TOKEN, [servers])
        self._allow(robot, "egress", _WATCH_TOKENS, [f"{self._all}/{keys.ALIVE}/*/*"])

    def allow_controller(self, grant: Grant, robots: Sequence[str]) -> None:
        """Allow a controller or an observer what its grant covers; `*` stands for every robot."""
        name = grant.name
        self._allow_calls(name, robots, _methods_of(grant))
        if grant.role == "controller":
            self._link(name, "ingress", [f"{keys.HEARTBEATS}/{name}/*"], [f"{keys.HEARTBEATS}/*/*"])
        resources = grant.resources or ("*",)
        published = [f"{keys.EVENTS}/{robot}" for robot in robots]
        published += [f"{keys.STREAMS}/{robot}/{resource}/**" for robot in robots for resource in resources]
        self._link(name, "egress", published, (f"{keys.EVENTS}/*", f"{keys.STREAMS}/**"))

    def allow_authority(self, robots: Sequence[str]) -> None:
        """Allow the holder of the authority's key to revoke certificates."""
        self._allow_calls(keys.AUTHORITY_CALLER, robots, [f"{keys.ROBOT}/{keys.REVOKE}"])

    def _allow_calls(self, name: str, robots: Sequence[str], methods: Iterable[str]) -> None:
        """Allow calls of methods, each as `<resource>/<method>`, their replies, and to see which robots are alive."""
        calls = [f"{robot}/{method}/{name}/*" for method in methods for robot in robots]
        self._link(name, "ingress", calls, [f"{robot}/**" for robot in robots])
        answers = [f"{keys.ANSWERS}/{name}/*/{robot}" for robot in robots]
        self._link(name, "egress", answers, [f"{keys.ANSWERS}/{name}/*/*"])
        self._allow(name, "egress", _DECLARE_TOKEN, [f"{self._all}/{keys.ALIVE}/*/{robot}" for robot in robots])
        self._allow(name, "ingress", _WATCH_TOKENS, [f"{self._all}/{keys.ALIVE}/*/*"])

    def _link(self, name: str, flow: _Flow, published: Sequence[str], subscribed: Sequence[str] = ()) -> None:
        """Allow publications one way over a link, and subscriptions to them the other way.

        Keys are key expressions below the fleet's key. The other end may subscribe within `subscribed`, or `published`
        if that is empty. Wider ones permit one subscription for all robots, each of which can still publish only what
        is allowed.
        """
        said, heard = ([f"{self._all}/{key}" for key in key_exprs] for key_exprs in (published, subscribed))
        self._allow(name, flow, _PUBLISH, said)
        self._allow(name, _FLOWS[flow == "ingress"], _SUBSCRIBE, heard or said)

    def _allow(self, name: str, flow: _Flow, messages: Sequence[str], key_exprs: Sequence[str]) -> None:
        rules = self._rules.setdefault(name, [])
        rules.append(
            {
                "id": f"{name}/{len(rules)}",
                "permission": "allow",
                "flows": [flow],
                "messages": list(messages),
                "key_exprs": list(dict.fromkeys(key_exprs)),
            }
        )


def _methods_of(grant: Grant) -> Iterator[str]:
    """Yield the calls of a grant, each as `<resource>/<method>`; `*` stands for all."""
    is_controller = grant.role == "controller"
    if is_controller and grant.resources is None:
        yield "*/*"
        return
    for method in LIMITED_ROBOT_METHODS if is_controller else OBSERVER_ROBOT_METHODS:
        yield f"{keys.ROBOT}/{method}"
    for resource in grant.resources or ("*",):
        for method in ("*",) if is_controller else (*OBSERVER_METHODS, keys.STREAM):
            yield f"{resource}/{method}"


def encode_rights(security: SecurityConfig | None, robot: str) -> list[list[Any]] | None:
    """Return a robot's grants as name, role and resources (None for all); None for a fleet without security."""
    if security is None:
        return None
    return [
        [grant.name, grant.role, None if grant.resources is None else list(grant.resources)]
        for grant in security.grants
        if grant.robots is None or robot in grant.robots
    ]


def _describe(grant: Grant) -> str:
    return grant.role if grant.resources is None else f"{grant.role} of {', '.join(sorted(grant.resources))} alone"


class Rights:
    """Calls that the holder of one certificate may make to one robot. Thread: any."""

    def __init__(self, name: str, grants: Sequence[Grant]) -> None:
        self._name = name
        self._roles = " and ".join(f"the role {_describe(grant)}" for grant in grants) or "no role"
        self._calls = frozenset(call for grant in grants for call in _methods_of(grant))

    @classmethod
    def by_file(cls, security: SecurityConfig, robot: str) -> Self:
        """Return the rights at a robot of the controller of a fleet file, by that file; the robot's own file counts."""
        name = security.controller
        grants = [it for it in security.grants if it.name == name and (it.robots is None or robot in it.robots)]
        return cls(name, grants)

    @classmethod
    def decode(cls, encoded: object, name: str) -> Self | None:
        """Decode the rights that a robot sent; None if everybody has all, ProtocolError if they are malformed."""
        if encoded is None:
            return None
        try:
            grants = [
                Grant(name, role, resources=None if resources is None else tuple(map(str, resources)))
                for holder, role, resources in encoded  # type: ignore[attr-defined]  # checked by trying
                if holder == name
            ]
        except (TypeError, ValueError) as error:
            raise ProtocolError(f"the rights {encoded!r} are malformed") from error
        return cls(name, grants)

    def allows(self, resource: str, method: str) -> bool:
        """Return whether the robot grants a call."""
        return not self._calls.isdisjoint((f"{resource}/{method}", f"{resource}/*", f"*/{method}", "*/*"))

    def check(self, resource: str, method: str) -> None:
        """Raise AccessDeniedError unless the robot grants a call."""
        if (denied := self.denied(resource, method)) is not None:
            raise AccessDeniedError(denied, resource=None if resource == keys.ROBOT else resource)

    def denied(self, resource: str, method: str) -> str | None:
        """Return why the robot does not grant a call; None if it does."""
        if self.allows(resource, method):
            return None
        what = f"{method} of the robot" if resource == keys.ROBOT else method
        return f"does not grant {what} to {self._name!r}, which has {self._roles} there"
