"""Runs an emulator as a program, behind a pseudo-terminal, until it is interrupted."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import math
import os
import signal
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Final

from .bodies import FreeRoombaBody
from .motes import ByteEmulator

TICK_S: Final = 0.001
"""Interval of paced bytes, and of unrequested output of the emulator."""
_BITS_A_BYTE: Final = 10  # a start bit, eight and a stop bit
_MOST_BYTES: Final = 4096


class LinePace:
    """Bytes in flight, which arrive at a baud rate.

    Args:
        baud_rate: None for no delay.
    """

    def __init__(self, baud_rate: int | None) -> None:
        self._byte_s = _BITS_A_BYTE / baud_rate if baud_rate else 0.0
        self._waiting = bytearray()
        self._free_s = -math.inf

    def put(self, data: bytes, now_s: float) -> None:
        """Send bytes."""
        if data and not self._waiting:
            self._free_s = max(self._free_s, now_s)
        self._waiting += data

    def take(self, now_s: float) -> bytes:
        """Return the bytes that have arrived by now."""
        count = len(self._waiting)
        if self._byte_s and count:
            count = min(count, max(0, math.floor((now_s - self._free_s) / self._byte_s + 1e-6)))
            self._free_s += count * self._byte_s
        arrived = bytes(self._waiting[:count])
        del self._waiting[:count]
        return arrived


class PacedLine:
    """An emulator at a line with a baud rate. Thread: its owner's.

    Args:
        emulator: the served one.
        baud_rate: of the line; None for no delay.
    """

    def __init__(self, emulator: ByteEmulator, baud_rate: int | None) -> None:
        self._emulator = emulator
        self._incoming, self._outgoing = LinePace(baud_rate), LinePace(baud_rate)

    def exchange(self, data: bytes, now_s: float) -> bytes:
        """Process bytes from the line, possibly none, and return the bytes sent on it."""
        self._incoming.put(data, now_s)
        self._outgoing.put(self._emulator.feed(self._incoming.take(now_s), now_s), now_s)
        return self._outgoing.take(now_s)


@asynccontextmanager
async def on_pty(serving: PacedLine) -> AsyncIterator[tuple[str, asyncio.Task[None]]]:
    """Serve behind a pseudo-terminal during a block; yields its path and the serving task."""
    if not hasattr(os, "openpty"):
        raise SystemExit("this system has no pseudo-terminals")
    import tty

    loop = asyncio.get_running_loop()
    master, slave = os.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    os.set_blocking(master, False)

    def exchange(data: bytes = b"") -> None:
        if reply := serving.exchange(data, loop.time()):
            with contextlib.suppress(BlockingIOError):  # without a reader, bytes that do not fit are lost, as on a wire
                os.write(master, reply)

    async def exchange_forever() -> None:
        while True:
            exchange()
            await asyncio.sleep(TICK_S)

    loop.add_reader(master, lambda: exchange(os.read(master, _MOST_BYTES)))
    going = asyncio.create_task(exchange_forever())
    try:
        yield os.ttyname(slave), going
    finally:
        going.cancel()
        loop.remove_reader(master)
        os.close(master)
        os.close(slave)


def parser(program: str, description: str) -> argparse.ArgumentParser:
    """Return a parser with the common arguments of the emulators."""
    made = argparse.ArgumentParser(prog=f"python -m {program}", description=description)
    made.add_argument("--pty", action="store_true", required=True, help="serve a pseudo-terminal, and print its path")
    made.add_argument("--pace", action="store_true", help="delay bytes by the baud rate of the line")
    return made


def run(make: Callable[[Callable[[], float]], tuple[ByteEmulator, FreeRoombaBody]], baud_rate: int | None) -> None:
    """Serve an emulator until it is interrupted; prints the port first, and the robot's pose at the end.

    Args:
        make: creates the emulator and its body from a function that returns the time.
        baud_rate: pace of the line; None for no delay.
    """
    asyncio.run(_run(make, baud_rate))


async def _run(
    make: Callable[[Callable[[], float]], tuple[ByteEmulator, FreeRoombaBody]], baud_rate: int | None
) -> None:
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    for name in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(name, ended.set)
    emulator, body = make(loop.time)
    async with on_pty(PacedLine(emulator, baud_rate)) as (port, going):
        _print(port)
        waiting = asyncio.create_task(ended.wait())
        await asyncio.wait((waiting, going), return_when=asyncio.FIRST_COMPLETED)
        if going.done():
            going.result()  # raises its error
    x_m, y_m, yaw_rad = body.pose
    _print(f"pose {x_m:.3f} m {y_m:.3f} m {math.degrees(yaw_rad):.1f} deg")


def _print(text: str) -> None:
    print(text, flush=True)  # noqa: T201  # it is a program
