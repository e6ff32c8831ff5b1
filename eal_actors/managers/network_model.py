"""The model of a fleet file's network section, and the resolved network."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, Field

from eal_actors.kernel.strict_model import Name, StrictModel
from eal_actors.kernel.suggestions import did_you_mean

PROTOCOLS: Final = ("tcp", "tls", "quic", "udp")
SECURE_PROTOCOLS: Final = ("tls", "quic")
IDENTITY_VARIABLE: Final = "EAL_FLEET_IDENTITY"
"""The environment variable that takes the place of a fleet's identity."""
IDENTITY_MARK: Final = "~"
"""Stands between the name of a fleet and its identity in keys of the network."""
BEHIND_ROUTER: Final = "router"
"""The address of a robot that does not listen, but connects to the network's routers."""

_HOST_NAME: Final = re.compile(r"(?=.{1,253}$)[A-Za-z0-9_]([A-Za-z0-9_-]*[A-Za-z0-9_])?(\.[A-Za-z0-9_-]+)*\.?")
_FORM: Final = "write it as tcp/192.168.1.11:50000"

Role = Literal["controller", "observer"]


@dataclass(frozen=True, slots=True)
class Endpoint:
    """An address to listen at or to connect to.

    The protocol is one of PROTOCOLS, an IPv6 address has no brackets, and the port is 1 to 65535.
    """

    protocol: str
    host: str
    port: int


def parse_endpoint(text: str) -> Endpoint:
    """Parse an endpoint such as `tls/robot.local:50000` or `tcp/[::1]:50000`.

    Raises ValueError if it is no endpoint; the message explains it.
    """
    protocol, slash, place = text.partition("/")
    if not slash:
        raise ValueError(f"{text!r} lacks the protocol; write tcp/{text}")
    if protocol not in PROTOCOLS:
        raise ValueError(f"unknown protocol {protocol!r} in {text!r}{did_you_mean(protocol, PROTOCOLS)}")
    host, colon, port = place.rpartition(":")
    if not colon or "]" in port or (":" in host and not host.startswith("[")):
        raise ValueError(f"{text!r} {_explain_place(place)}")
    if not (port.isascii() and port.isdigit() and 1 <= int(port) <= 65535):
        raise ValueError(f"the port in {text!r} must be a whole number from 1 to 65535, not {port!r}")
    return Endpoint(protocol, _host(host, text), int(port))


def is_loopback(host: str) -> bool:
    """Return whether only programs of the same machine reach a host."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _explain_place(place: str) -> str:
    if place.count(":") > 1 and not place.endswith("]"):
        return "has an IPv6 address without brackets; write it as tcp/[fe80::1]:50000"
    return f"lacks the port; {_FORM}"


def _host(host: str, text: str) -> str:
    is_bracketed = host.startswith("[") and host.endswith("]")
    bare = host[1:-1] if is_bracketed else host
    try:
        version = ipaddress.ip_address(bare).version
    except ValueError:
        looks_like_ip = re.fullmatch(r"[0-9.]+", host) is not None
        if is_bracketed or looks_like_ip or not _HOST_NAME.fullmatch(host):
            raise ValueError(f"{host!r} in {text!r} is neither a host name nor an IP address; {_FORM}") from None
        return host
    if is_bracketed != (version == 6):
        raise ValueError(f"{host!r} in {text!r}: brackets are for IPv6 addresses alone; {_FORM}")
    return bare


def _check_endpoint(text: str) -> str:
    parse_endpoint(text.replace("{n}", "1"))
    return text


def check_address(text: str) -> str:
    """Return a robot's address if a controller can connect to it; `{n}` is a placeholder for a number.

    Raises ValueError if a controller cannot connect to it.
    """
    if text == BEHIND_ROUTER:
        return text
    host = parse_endpoint(text.replace("{n}", "1")).host
    if host in ("0.0.0.0", "::"):  # noqa: S104  # it is refused here
        raise ValueError(f"{host} is where a robot may listen, not where it is reached; put it under 'listen'")
    return text


EndpointText = Annotated[str, AfterValidator(_check_endpoint)]
"""An endpoint, in which `{n}` is replaced by a robot's number."""

AddressText = Annotated[str, AfterValidator(check_address)]
"""The address of a robot: an endpoint, or `router`."""


class GrantSection(StrictModel):
    """A role that is limited to some robots, or to some resources of each."""

    name: Name
    """Name of the certificate."""
    robots: tuple[Name, ...] | None = Field(default=None, strict=False, min_length=1)
    """Only these robots; all if left out."""
    resources: tuple[Name, ...] | None = Field(default=None, strict=False, min_length=1)
    """Only these resources; all if left out."""


class RolesSection(StrictModel):
    """Permissions by the names of certificates; a certificate that is not named has none."""

    controllers: tuple[Name | GrantSection, ...] = Field(default=(), strict=False)
    """May do everything."""
    observers: tuple[Name | GrantSection, ...] = Field(default=(), strict=False)
    """May read values, states, events and streams, and send the requests that a resource declares."""
    routers: tuple[Name, ...] = Field(default=(), strict=False)
    """Forward the traffic of others, and check their permissions."""


class SecuritySection(StrictModel):
    """Mutual TLS and access control; `eal keys` makes the certificates."""

    keys: Annotated[str, Field(min_length=1)] = "keys"
    """Folder of certificates, relative to this file."""
    controller: Name = "controller"
    """Name of the certificate of programs that use this file."""
    roles: RolesSection = RolesSection()


class NetworkSection(StrictModel):
    """How controllers reach the robots that have an address. Seconds are real ones."""

    identity: Name | None = None
    """Tells this fleet from others of the same name; $EAL_FLEET_IDENTITY takes its place."""
    lease_s: float = Field(default=2.0, ge=0.3, le=60.0)
    """Seconds of silence after which the other end of a connection counts as lost."""
    lost_after_s: float | None = Field(default=None, ge=0.0, le=3600.0)
    """Seconds after the loss of a robot until its step of a scenario fails; defaults to `lease_s`."""
    dead_man_s: float = Field(default=2.0, ge=0.1, le=60.0)
    """Seconds of silence of the controller after which a robot halts what it moves."""
    compression: bool = False
    """Compress all traffic; for slow links only, and nothing is compressed unless both ends do it."""
    shared_memory: bool = True
    """Share memory for large values, and a socket for calls, with programs of the same user on the same machine."""
    discovery: bool = False
    """Let listening robots and routers answer `eal discover`, a multicast."""
    routers: tuple[EndpointText, ...] = Field(default=(), strict=False)
    """Endpoints of routers, to which controllers and robots with the address `router` connect."""
    security: SecuritySection | None = None
    """Without it, every program on the network may command the robots."""


@dataclass(frozen=True, slots=True)
class Grant:
    """The permissions of one certificate; see RolesSection and GrantSection."""

    name: str
    role: Role
    robots: tuple[str, ...] | None = None
    resources: tuple[str, ...] | None = None


@dataclass(frozen=True, slots=True)
class SecurityConfig:
    """Permissions, and the keys that prove identities.

    `controller` is the name of the certificate of this fleet's controllers. `grants` are the permissions; everything
    else is denied.
    """

    keys: Path
    controller: str
    grants: tuple[Grant, ...]
    routers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class NetworkConfig:
    """The network of a fleet; its other fields are those of NetworkSection."""

    lease_s: float = 2.0
    dead_man_s: float = 2.0
    compression: bool = False
    discovery: bool = False
    routers: tuple[str, ...] = ()
    security: SecurityConfig | None = None
    shared_memory: bool = True
    identity: str | None = None
    lost_after_s: float | None = None


def new_identity() -> str:
    """Return an identity that no other fleet has."""
    return f"id-{token_hex(4)}"


DEFAULT_NETWORK: Final = NetworkConfig()
"""The network of a fleet without a network section."""


def network_config(section: NetworkSection, folder: Path, identity: str | None = None) -> NetworkConfig:
    """Build the network from its section in a file of a folder; an identity replaces that of the section."""
    values = {name: getattr(section, name) for name in NetworkSection.model_fields}
    values["identity"] = identity or section.identity
    if (security := section.security) is not None:
        grants = tuple(_grants(security.roles))
        values["security"] = SecurityConfig(folder / security.keys, security.controller, grants, security.roles.routers)
    return NetworkConfig(**values)


def _grants(roles: RolesSection) -> Iterator[Grant]:
    entries: tuple[tuple[Role, tuple[Name | GrantSection, ...]], ...] = (
        ("controller", roles.controllers),
        ("observer", roles.observers),
    )
    for role, grants in entries:
        for grant in grants:
            if isinstance(grant, str):
                yield Grant(grant, role)
            else:
                yield Grant(grant.name, role, grant.robots, grant.resources)
