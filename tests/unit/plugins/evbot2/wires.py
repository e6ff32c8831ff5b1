"""Real wires to the emulators: each in an event loop of its own thread, for the length of a `with` block."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractAsyncContextManager, contextmanager
from random import Random

from plugins.evbot2.emulator import evbot2, free_vehicle
from plugins.evbot2.firmware import BaseEmulator
from plugins.evbot2.serving import TICK_S, DeviceTime, EmulatorServer, FaultyWire, on_pty
from plugins.evbot2.vehicle import FreeVehicle

WAIT_S = 10.0


@contextmanager
def in_a_loop(serve: Callable[[], AbstractAsyncContextManager[str]]) -> Iterator[str]:
    """Serve in a thread of its own for the length of a block; gives what the serving gives: its address."""
    up, address, problems = threading.Event(), [""], []
    loop, end = asyncio.new_event_loop(), asyncio.Event()

    async def run() -> None:
        try:
            async with serve() as address[0]:
                up.set()
                await end.wait()
        except BaseException as error:
            problems.append(error)
            raise
        finally:
            up.set()

    def serve_all() -> None:
        with asyncio.Runner(loop_factory=lambda: loop) as runner:
            runner.run(run())

    thread = threading.Thread(target=serve_all, name="an emulator's loop")
    thread.start()
    assert up.wait(WAIT_S)
    try:
        assert not problems, problems
        yield address[0]
    finally:
        if not problems:
            loop.call_soon_threadsafe(end.set)
        thread.join(WAIT_S)
        assert not thread.is_alive()


def plain_wires() -> tuple[FaultyWire, FaultyWire]:
    return FaultyWire(Random(0)), FaultyWire(Random(0))  # noqa: S311


@contextmanager
def evbot2_on_a_pty(
    boot: int = 7, *, baud_rate: int | None = None, rate: float = 1.0
) -> Iterator[tuple[str, FreeVehicle, BaseEmulator]]:
    """Serve an EvBot II behind a pseudo-terminal; gives its path, its body and the device."""
    made: list[tuple[FreeVehicle, BaseEmulator]] = []

    def serve() -> AbstractAsyncContextManager[str]:
        loop = asyncio.get_running_loop()
        now_s = DeviceTime(loop.time, rate)
        body = free_vehicle(now_s)
        made.append((body, evbot2(body, TICK_S * rate, boot)))
        return on_pty(EmulatorServer(made[0][1], *plain_wires(), now_s, baud_rate))

    with in_a_loop(serve) as path:
        yield path, *made[0]
