"""Access: who may watch and who may command. Pure rules, without a web server."""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from dataclasses import dataclass
from typing import Final
from urllib.parse import urlsplit

_TOKEN_BYTES: Final = 24


def new_token() -> str:
    """Return a random token."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach a listening address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True)
class Access:
    """The access rules of one dashboard.

    With a token, its holders may command and everybody else may watch. Without a token, everybody may command on a
    loopback address, and nobody elsewhere.

    A page of another site must not use the dashboard in the name of its user, so `Origin` must be the dashboard itself.
    Another site's name could resolve to this machine and pass as the same origin (DNS rebinding), so `Host` must be an
    address, this machine's name, or the name that the dashboard listens at.

    Attributes:
        host: the listening address.
        token: proof of permission to command; None for no token.
    """

    host: str
    token: str | None = None

    @property
    def is_open(self) -> bool:
        """Whether everybody may command."""
        return self.token is None and is_loopback(self.host)

    def refusal(self, shown: str | None) -> str | None:
        """Return why the holder of a token, or of none, may not command; None if it may."""
        if self.is_open:
            return None
        if self.token is None:
            return "read only: start the dashboard with --token to command from other machines"
        if shown is None:
            return "read only: open the link with the token to command"
        if not hmac.compare_digest(shown.encode(), self.token.encode()):
            return "read only: wrong token"
        return None

    def knows_host(self, host_header: str | None) -> bool:
        """Return whether a request's `Host` names this dashboard."""
        name = _hostname(f"//{host_header}") if host_header else None
        if name is None:
            return False
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name in {"localhost", self.host.lower(), socket.gethostname().lower()}
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
