"""Who may look, and who may command: the rules alone, without a web server."""

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
    """Return a token that nobody guesses."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def is_loopback(host: str) -> bool:
    """Return whether an address to listen at is reached from this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True)
class Access:
    """The rules of one dashboard.

    With a token, whoever shows it may command, and everybody else may look. Without one, everybody may command where
    the dashboard listens on loopback alone, and nobody where others reach it.

    A page of another site must not speak to the dashboard in the name of its user: `Origin` must be the dashboard
    itself. Nor may another site's name lead here, so that it would be the same origin: `Host` must be an address,
    this machine's name, or the name that the dashboard was told to listen at.

    Attributes:
        host: where it listens.
        token: what those who may command show; None for no such thing.
    """

    host: str
    token: str | None = None

    @property
    def is_open(self) -> bool:
        """Whether everybody may command."""
        return self.token is None and is_loopback(self.host)

    def refusal(self, shown: str | None) -> str | None:
        """Return why somebody who shows a token, or none, may not command; None if he may."""
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
        """Return whether a request's `Host` is a name of this dashboard."""
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
