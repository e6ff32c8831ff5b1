"""The emulator for `eal plugin check`: a peer that echoes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ..serial_port.echo import Echo


def emulate(settings: Mapping[str, Any], now_s: Callable[[], float]) -> Echo | None:  # noqa: ARG001  # an echo has none
    """Return an echo over TCP; None over UDP, where the absence of the peer cannot be noticed."""
    return Echo() if settings.get("protocol", "tcp") == "tcp" else None
