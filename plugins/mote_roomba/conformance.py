"""The Roomba that stands in for a real one where the plugin is checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .bodies import FreeBody
from .emulator import RoombaEmulator
from .motes import Emulator, MotePair
from .plugin import Settings
from .protocol import WHEELBASE_M


class _StandIn:
    """An emulator whose body goes by the time that it is fed."""

    def __init__(self, settings: Settings) -> None:
        self._now_s = 0.0
        self._roomba = RoombaEmulator(FreeBody(lambda: self._now_s, WHEELBASE_M), mode_pause_s=0.0)
        self._first: Emulator = self._roomba
        if settings.link == "mote":
            self._first = MotePair(self._roomba, settings.motes().framing())

    @property
    def complaints(self) -> list[str]:
        """What it could not make sense of."""
        return list(self._roomba.complaints)

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the wire and return the reply to them."""
        self._now_s = now_s
        return self._first.feed(data, now_s)


def wire(settings: Mapping[str, Any]) -> str | None:
    """Return what it is connected by; None where the settings name a Roomba themselves."""
    return None if "port" in settings else "pty"


def settings(address: str) -> dict[str, Any]:
    """Return the settings under which the plugin finds it."""
    return {"port": address}


def emulate(settings: Mapping[str, Any]) -> _StandIn:
    """Return a Roomba in free space."""
    return _StandIn(Settings.model_validate({"port": "pty", **settings}))
