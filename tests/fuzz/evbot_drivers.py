"""The EvBots' drivers on a noisy wire."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Final

from plugins.evbot2 import plugin as evbot2_plugin
from plugins.evbot2.emulator import evbot2, free_vehicle
from plugins.evbot2.protocol import BAUD_RATE
from plugins.evbot2.vehicle import FreeVehicle
from plugins.evbot3 import plugin as evbot3_plugin
from plugins.evbot3.emulator import FreeTurretVehicle, evbot3
from tests.fuzz.motions import FuzzedDriver
from tests.fuzz.noisy_wire import TICK_S, ByteDevice, Line


def _evbot2(now_s: Callable[[], float], random: Random) -> tuple[ByteDevice, FreeVehicle]:
    body = free_vehicle(now_s)
    return evbot2(body, TICK_S, random.randrange(1, 1 << 16)), body


def _evbot3(now_s: Callable[[], float], random: Random) -> tuple[ByteDevice, FreeTurretVehicle]:
    body = FreeTurretVehicle(now_s)
    return evbot3(body, TICK_S, random.randrange(1, 1 << 16)), body


EVBOT_DRIVERS: Final = (
    FuzzedDriver("evbot2-cable", evbot2_plugin, {"port": "sim://wire"}, _evbot2, Line(BAUD_RATE)),
    FuzzedDriver("evbot3-stream", evbot3_plugin, {"address": "sim://wire"}, _evbot3, Line(1_000_000, 0.002, 0.002)),
)
