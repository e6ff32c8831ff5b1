"""The EvBot III that stands in for a real one where the plugin is checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..evbot2.firmware import any_boot
from ..evbot2.serving import TICK_S
from .emulator import FreeTurretBody, evbot3


class _StandIn:
    """A device whose body goes by the time that it is fed."""

    def __init__(self) -> None:
        self._now_s = 0.0
        self._device = evbot3(FreeTurretBody(lambda: self._now_s), TICK_S, any_boot())

    @property
    def complaints(self) -> list[str]:
        """What it could not make sense of."""
        counts = {"damaged": self._device.damaged, "without sense": self._device.nonsense}
        return [f"{count} requests {what}" for what, count in counts.items() if count]

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the wire and return the replies to them."""
        self._now_s = now_s
        return self._device.feed(data, now_s)


def wire(settings: Mapping[str, Any]) -> str:  # noqa: ARG001  # whatever they are
    """Return what it is connected by."""
    return "udp"


def settings(address: str) -> dict[str, Any]:
    """Return the settings under which the plugin finds it."""
    return {"address": f"udp://{address}"}


def emulate(settings: Mapping[str, Any]) -> _StandIn:  # noqa: ARG001  # whatever they are
    """Return one on an endless floor."""
    return _StandIn()
