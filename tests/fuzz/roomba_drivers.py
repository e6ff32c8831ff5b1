"""The Roomba's driver on a noisy wire: one entry for each protocol and link."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any, Final

from plugins.roomba import oi, plugin
from plugins.roomba.bodies import FreeRoombaBody
from plugins.roomba.motes import MotePair
from plugins.roomba.oi_emulator import OiEmulator
from plugins.roomba.sci import WHEELBASE_M
from plugins.roomba.sci_emulator import SciEmulator
from plugins.roomba.tinyos import TinyosFraming
from tests.fuzz.motions import FuzzedDriver
from tests.fuzz.noisy_wire import ByteDevice, Line

_ACCELERATIONS_M_S2: Final = (0.5, 0.8, 1.5)


def _sci(now_s: Callable[[], float], random: Random) -> tuple[ByteDevice, FreeRoombaBody]:
    body = FreeRoombaBody(now_s, WHEELBASE_M, random.choice(_ACCELERATIONS_M_S2))
    return SciEmulator(body, mode_pause_s=0.0), body


def _oi(now_s: Callable[[], float], random: Random) -> tuple[ByteDevice, FreeRoombaBody]:
    body = FreeRoombaBody(now_s, WHEELBASE_M, random.choice(_ACCELERATIONS_M_S2))  # that of a simulated port
    return OiEmulator(body, mode_pause_s=0.0, wheelbase_m=WHEELBASE_M), body


def _motes(now_s: Callable[[], float], random: Random) -> tuple[ByteDevice, FreeRoombaBody]:
    roomba, body = _sci(now_s, random)
    return MotePair(roomba, TinyosFraming()), body


def _roomba(**settings: Any) -> dict[str, Any]:
    return {"port": "sim://wire", **settings}


ROOMBA_DRIVERS: Final = (
    FuzzedDriver("roomba-sci-cable", plugin, _roomba(protocol="sci"), _sci, Line(57600)),
    FuzzedDriver("roomba-sci-mote", plugin, _roomba(protocol="sci", link="mote"), _motes, Line(115200, 0.005, 0.005)),
    FuzzedDriver("roomba-oi-cable", plugin, _roomba(protocol="oi"), _oi, Line(oi.BAUD_RATE)),
)
