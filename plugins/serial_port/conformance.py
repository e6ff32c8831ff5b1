"""What stands in for a device when `eal plugin check` is run: an echo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


class Echo:
    """Says what it hears."""

    def feed(self, data: bytes, now_s: float) -> bytes:  # noqa: ARG002  # it has no sense of time
        """Return the bytes that came."""
        return data


def wire(settings: Mapping[str, Any]) -> str:  # noqa: ARG001  # it is the same for all
    """Return what it is connected by."""
    return "pty"


def settings(address: str) -> dict[str, Any]:
    """Return the settings under which the plugin finds it."""
    return {"port": address}


def emulate(settings: Mapping[str, Any]) -> Echo:  # noqa: ARG001  # it is the same for all
    """Return what is at the other end."""
    return Echo()
