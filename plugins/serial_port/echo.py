"""The emulator for `eal plugin check`: a device that echoes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any


class Echo:
    """Returns the bytes that it receives."""

    def feed(self, data: bytes, now_s: float) -> bytes:  # noqa: ARG002  # an echo is immediate
        """Return the received bytes."""
        return data


def emulate(settings: Mapping[str, Any], now_s: Callable[[], float]) -> Echo:  # noqa: ARG001  # the same for all
    """Return an echo."""
    return Echo()
