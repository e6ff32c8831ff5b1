"""What stands in for the other end when `eal plugin check` is run: an echo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..serial_port.conformance import Echo


def wire(settings: Mapping[str, Any]) -> str | None:
    """Return what it is connected by; over UDP nobody can tell that the other end is gone."""
    return "tcp" if settings.get("protocol", "tcp") == "tcp" else None


def settings(address: str) -> dict[str, Any]:
    """Return the settings under which the plugin finds it."""
    host, _, port = address.partition(":")
    return {"host": host, "port": int(port)}


def emulate(settings: Mapping[str, Any]) -> Echo:  # noqa: ARG001  # it is the same for all
    """Return what is at the other end."""
    return Echo()
