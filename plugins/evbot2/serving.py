"""Runs a device as a program, behind a pseudo-terminal, a TCP port or a UDP port, until it is told to end."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import signal
import sys
import tty
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from functools import partial
from typing import Final

from .body import FreeBody
from .device import Device
from .faults import FaultyWire

TICK_S: Final = 0.005
"""How often a device that is served looks after what moves."""

_BITS_A_BYTE: Final = 10
_MOST_BYTES: Final = 4096

Address = tuple[str, int]


class _Pace:
    """One way of a line, on which bytes take their time. Args: baud_rate; None for at once."""

    def __init__(self, baud_rate: int | None) -> None:
        self._baud_rate = baud_rate
        self._loop = asyncio.get_running_loop()
        self._free_at_s = self._loop.time()

    def carry(self, data: bytes, deliver: Callable[[bytes], object]) -> None:
        """Deliver bytes when the last of them has arrived."""
        if self._baud_rate is None:
            deliver(data)
            return
        self._free_at_s = max(self._free_at_s, self._loop.time()) + len(data) * _BITS_A_BYTE / self._baud_rate
        self._loop.call_at(self._free_at_s, deliver, data)


class Serving:
    """What is common to all ways of serving a device. Thread: that of its event loop.

    Args:
        device: the device.
        incoming: what happens to pieces on their way to it.
        outgoing: what happens to its replies.
        baud_rate: pace of both ways; None for at once.
        rate: seconds of the device's time in one real second.
    """

    def __init__(
        self,
        device: Device,
        incoming: FaultyWire,
        outgoing: FaultyWire,
        baud_rate: int | None = None,
        rate: float = 1.0,
    ) -> None:
        self._device = device
        self._incoming, self._outgoing = incoming, outgoing
        self._there, self._back = _Pace(baud_rate), _Pace(baud_rate)
        self._rate = rate
        self._loop = asyncio.get_running_loop()

    def take(self, piece: bytes, send: Callable[[bytes], object]) -> None:
        """Hand a piece to the device when it has arrived, and its replies to a function when they have."""
        for arrived in self._incoming.carry(piece):
            self._there.carry(arrived, partial(self._reply, send=send))

    def _reply(self, request: bytes, send: Callable[[bytes], object]) -> None:
        for reply in self._device.replies(request, self._loop.time() * self._rate):
            for sent in self._outgoing.carry(reply):
                self._back.carry(sent, send)

    async def keep_ticking(self) -> None:
        """Let the device's time pass, for ever."""
        while True:
            self._device.tick(self._loop.time() * self._rate)
            await asyncio.sleep(TICK_S)

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Let the device's time pass for the length of a block."""
        ticking = asyncio.create_task(self.keep_ticking())
        try:
            yield
        finally:
            ticking.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await ticking


async def run(served: AbstractAsyncContextManager[str], body: FreeBody, scheme: str = "") -> None:
    """Serve until Ctrl-C or SIGTERM; at first it prints where, at the end the robot's pose.

    Args:
        served: serves for the length of a block, and gives the address.
        body: the robot's body.
        scheme: what stands before the address, such as `udp://`.
    """
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    async with served as address:
        _say(f"{scheme}{address}")
        await ended.wait()
    x_m, y_m, yaw_rad = body.pose
    _say(f"pose {x_m:.4f} m {y_m:.4f} m {math.degrees(yaw_rad):.2f} deg")


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


@asynccontextmanager
async def on_pty(serving: Serving) -> AsyncIterator[str]:
    """Serve behind a pseudo-terminal for the length of a block; gives the path of its port."""
    loop = asyncio.get_running_loop()
    master, slave = os.openpty()
    try:
        tty.setraw(master)
        tty.setraw(slave)
        os.set_blocking(master, False)

        def send(data: bytes) -> None:
            with contextlib.suppress(BlockingIOError):  # nobody reads: what does not fit is lost, as on a wire
                os.write(master, data)

        loop.add_reader(master, lambda: serving.take(os.read(master, _MOST_BYTES), send))
        async with serving.running():
            yield os.ttyname(slave)
    finally:
        loop.remove_reader(master)
        os.close(master)
        os.close(slave)


@asynccontextmanager
async def on_tcp(serving: Serving, address: Address) -> AsyncIterator[str]:
    """Serve TCP connections for the length of a block; gives `host:port`."""
    connections: dict[asyncio.Task[None] | None, asyncio.StreamWriter] = {}

    async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connections[task := asyncio.current_task()] = writer
        with contextlib.suppress(ConnectionError):
            while data := await reader.read(_MOST_BYTES):
                serving.take(data, writer.write)
        del connections[task]
        writer.close()

    server = await asyncio.start_server(connected, *address)
    try:
        async with serving.running():
            yield _shown(server.sockets[0].getsockname())
    finally:
        server.close()
        for writer in connections.values():
            writer.close()
        await asyncio.gather(*filter(None, connections))
        await server.wait_closed()


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, serving: Serving) -> None:
        self._serving = serving
        self._transport: asyncio.DatagramTransport

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self._serving.take(data, lambda reply: self._transport.sendto(reply, addr))


@asynccontextmanager
async def on_udp(serving: Serving, address: Address) -> AsyncIterator[str]:
    """Serve datagrams for the length of a block; gives `host:port`."""
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(lambda: _Datagrams(serving), local_addr=address)
    try:
        async with serving.running():
            yield _shown(transport.get_extra_info("sockname"))
    finally:
        transport.close()


def _shown(address: Address) -> str:
    return f"{address[0]}:{address[1]}"
