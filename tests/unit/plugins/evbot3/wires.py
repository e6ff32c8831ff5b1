"""Real networks to the emulator of an EvBot III, on this machine."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import AbstractAsyncContextManager, contextmanager

from plugins.evbot2.firmware import any_boot
from plugins.evbot2.serving import TICK_S, DeviceTime, EmulatorServer, on_tcp, on_udp
from plugins.evbot3.emulator import FreeTurretVehicle, evbot3
from tests.unit.plugins.evbot2.wires import in_a_loop, plain_wires


@contextmanager
def evbot3_on(scheme: str, port: int = 0, rate: float = 1.0) -> Iterator[tuple[str, FreeTurretVehicle]]:
    """Serve an EvBot III over `udp` or `tcp`; gives the address for the fleet file, and its body."""
    bodies: list[FreeTurretVehicle] = []

    def serve() -> AbstractAsyncContextManager[str]:
        loop = asyncio.get_running_loop()
        now_s = DeviceTime(loop.time, rate)
        bodies.append(FreeTurretVehicle(now_s))
        serving = EmulatorServer(evbot3(bodies[0], TICK_S * rate, any_boot()), *plain_wires(), now_s)
        return {"udp": on_udp, "tcp": on_tcp}[scheme](serving, ("127.0.0.1", port))

    with in_a_loop(serve) as address:
        yield f"{scheme}://{address}", bodies[0]
