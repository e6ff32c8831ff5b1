"""Access: who may watch and who may command. Pure rules, without a web server."""

from __future__ import annotations

import hmac
import ipaddress
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final
from urllib.parse import urlsplit

from eal_actors.kernel.errors import AccessDeniedError
from eal_actors.managers.fleet_model import OperatorSection
from eal_actors.managers.network_model import is_loopback
from eal_actors.operate.dashboard.tokens import matches

_NOBODY: Final = "scrypt:14:AAAAAAAAAAAAAAAAAAAAAA:"


class Role(IntEnum):
    """A role of a user of the dashboard. Each role includes those before it."""

    WATCH = 1
    """Permission to see the fleet, its runs and its log."""
    DRIVE = 2
    """Permission to stop and resume the robots, command them, and drive by hand."""
    RUN = 3
    """Permission to start and control scenarios."""
    ADMINISTER = 4
    """Permission to change settings of resources, and to reload the fleet file."""


@dataclass(frozen=True, slots=True)
class Visitor:
    """A user of the dashboard.

    Attributes:
        name: an operator's, else how the user got in.
        is_proven: whether a token has proven it.
        why: why the user may do no more; None for an administrator.
    """

    name: str
    role: Role
    is_proven: bool = False
    why: str | None = None

    def refusal(self, needed: Role) -> str | None:
        """Return why the user lacks a role; None if the user has it."""
        if self.role >= needed:
            return None
        return self.why or f"{self.name} has the role {self.role.name.lower()}; this needs {needed.name.lower()}"


@dataclass
class Access:
    """The access rules of one dashboard.

    With operators, each user needs the token of one of them. With a token, its holders may do everything and everybody
    else may watch. Without either, everybody may do everything on a loopback address, and watch elsewhere.

    A page of another site must not use the dashboard in the name of its user, so `Origin` must be the dashboard itself.
    Another site's name could resolve to this machine and pass as the same origin (DNS rebinding), so `Host` must be an
    address, this machine's name, the name that the dashboard listens at, or one of its certificate.

    `operators` and `names` are replaced as a whole while the dashboard serves. A dashboard that began with operators
    admits nobody once it has none.

    Attributes:
        token: proof of permission to command; None for no token.
        names: the host names in the dashboard's certificate.
        asks_for_names: whether each user must be an operator.
    """

    host: str
    token: str | None = None
    operators: Mapping[str, OperatorSection] = field(default_factory=dict)
    names: Sequence[str] = ()
    asks_for_names: bool = field(init=False)

    def __post_init__(self) -> None:
        self.asks_for_names = bool(self.operators)

    @property
    def is_open(self) -> bool:
        """Whether everybody may command."""
        return self.token is None and not self.asks_for_names and is_loopback(self.host)

    def visitor(self, shown: str | None) -> Visitor:
        """Return the holder of a token, or None.

        Raises AccessDeniedError if there are operators, and the token is of none of them. Thread: blocks for one hash
        if there are operators.
        """
        if self.asks_for_names:
            return self._operator(shown)
        if self.is_open:
            return Visitor("anybody", Role.ADMINISTER)
        if self.token is None:
            why = "read only: start the dashboard with --token to command from other machines"
        elif shown is None:
            why = "read only: open the link with the token to command"
        elif hmac.compare_digest(shown.encode(), self.token.encode()):
            return Visitor("token holder", Role.ADMINISTER, is_proven=True)
        else:
            why = "read only: wrong token"
        return Visitor("anybody", Role.WATCH, why=why)

    def _operator(self, shown: str | None) -> Visitor:
        if shown is None:
            raise AccessDeniedError("sign in with your token")
        name, _, token = shown.rpartition(".")
        operator = self.operators.get(name)
        is_right = matches(token, _NOBODY if operator is None else operator.token)  # takes as long for a wrong name
        if operator is None or not is_right:
            raise AccessDeniedError("wrong token")
        return Visitor(name, Role[operator.role.upper()], is_proven=True)

    def knows_host(self, host_header: str | None) -> bool:
        """Return whether a request's `Host` names this dashboard."""
        name = _hostname(f"//{host_header}") if host_header else None
        if name is None:
            return False
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name in {"localhost", self.host.lower(), socket.gethostname().lower(), *map(str.lower, self.names)}
        return True

    def knows_origin(self, origin: str | None, host_header: str | None) -> bool:
        """Return whether a request comes from the dashboard's own page."""
        if origin is None or host_header is None:
            return False
        scheme, separator, place = origin.partition("://")
        return scheme in ("http", "https") and bool(separator) and place.lower() == host_header.lower()


def _hostname(url: str) -> str | None:
    try:
        return urlsplit(url).hostname
    except ValueError:
        return None
