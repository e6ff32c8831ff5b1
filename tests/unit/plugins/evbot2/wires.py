"""Real wires to the emulators of both EvBots, for the length of a `with` block."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from random import Random

from eal_actors.device.emulator_wires import WIRES, DeviceEmulator
from eal_actors.device.serving_emulators import PacedEmulator
from eal_actors.kernel.clock import REAL_TIME
from plugins.evbot2.emulator import evbot2, free_vehicle
from plugins.evbot2.firmware import BaseEmulator, any_boot
from plugins.evbot2.serving import TICK_S, DeviceTime, FaultyWire, ServedBase
from plugins.evbot2.vehicle import FreeVehicle
from plugins.evbot3.emulator import FreeTurretVehicle, evbot3


def _served(device: BaseEmulator, now_s: DeviceTime) -> ServedBase:
    return ServedBase(device, now_s, *(FaultyWire(Random(0)) for _ in range(2)))  # noqa: S311


@contextmanager
def _on(kind: str, emulator: DeviceEmulator, port: int = 0) -> Iterator[str]:
    wire = WIRES[kind](lambda: emulator, TICK_S, ("127.0.0.1", port))
    wire.plug_in()
    try:
        yield wire.address
    finally:
        wire.close()


@contextmanager
def evbot2_on_a_pty(
    boot: int = 7, *, baud_rate: int | None = None, rate: float = 1.0
) -> Iterator[tuple[str, FreeVehicle, BaseEmulator]]:
    """Serve an EvBot II behind a pseudo-terminal; gives its path, its body and the device."""
    now_s = DeviceTime(REAL_TIME.now, rate)
    body = free_vehicle(now_s)
    device = evbot2(body, TICK_S * rate, boot)
    with _on("pty", PacedEmulator(_served(device, now_s), baud_rate)) as path:
        yield path, body, device


@contextmanager
def evbot3_on(scheme: str, port: int = 0, rate: float = 1.0) -> Iterator[tuple[str, FreeTurretVehicle]]:
    """Serve an EvBot III over `udp` or `tcp`; gives the address for the fleet file, and its body."""
    now_s = DeviceTime(REAL_TIME.now, rate)
    body = FreeTurretVehicle(now_s)
    with _on(scheme, _served(evbot3(body, TICK_S * rate, any_boot()), now_s), port) as address:
        yield f"{scheme}://{address}", body
