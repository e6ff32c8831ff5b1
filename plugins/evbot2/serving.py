"""Serves an emulated base as a program: on a pseudo-terminal, a TCP port or a UDP port, until a signal ends it."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import signal
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from functools import partial
from random import Random
from typing import Final

from .firmware import BaseEmulator
from .vehicle import FreeVehicle

TICK_S: Final = 0.005
"""Tick interval of a served base."""

_BITS_A_BYTE: Final = 10
_MOST_BYTES: Final = 4096
_LONGEST_STEP_S: Final = 0.05  # a process that is not served for longer has been starved

Address = tuple[str, int]


class FaultyWire:
    """Loses, duplicates and reorders messages in one direction; a delayed message arrives with a later one.

    Args:
        random: the random generator.
        loss: share of the messages that are lost, 0..1.
        duplicate: share of the others that arrive twice, the second time possibly much later, 0..1.
        reorder: share of the others that are delayed, 0..1.
    """

    def __init__(self, random: Random, loss: float = 0.0, duplicate: float = 0.0, reorder: float = 0.0) -> None:
        self._random = random
        self._loss = loss
        self._duplicate = duplicate
        self._reorder = reorder
        self._held: list[bytes] = []

    def carry(self, piece: bytes) -> list[bytes]:
        """Take a message and return those that arrive now, in order of arrival."""
        arriving = []
        if self._random.random() >= self._loss:
            is_late = self._random.random() < self._reorder
            if not is_late:
                arriving.append(piece)
            if is_late or self._random.random() < self._duplicate:
                self._held.append(piece)
        while self._held and self._random.random() < 0.5:
            arriving.append(self._held.pop(self._random.randrange(len(self._held))))
        return arriving


class _BaudRateDelay:
    """The transmission delay of one direction of a line. Args: baud_rate; None for no delay."""

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


class DeviceTime:
    """The time of an emulated device, which stands still while its process gets no processor time.

    So a busy computer makes the device slow, but its watchdog does not fire for messages that wait to be read.

    Args:
        now_s: returns the real time in seconds.
        rate: seconds of the device's time in one real second.
    """

    def __init__(self, now_s: Callable[[], float], rate: float = 1.0) -> None:
        self._now_s, self._rate = now_s, rate
        self._seen_s, self._passed_s = now_s(), 0.0

    def __call__(self) -> float:
        """Return the time in seconds since the start."""
        now_s = self._now_s()
        self._passed_s += min(now_s - self._seen_s, _LONGEST_STEP_S) * self._rate
        self._seen_s = now_s
        return self._passed_s


class EmulatorServer:
    """Serves an emulated base. Thread: the one of its event loop.

    Args:
        device: the base.
        incoming: the wire for requests.
        outgoing: the wire for replies.
        now_s: returns the device's time, the same as that of its vehicle.
        baud_rate: of both directions; None for no delay.
    """

    def __init__(
        self,
        device: BaseEmulator,
        incoming: FaultyWire,
        outgoing: FaultyWire,
        now_s: Callable[[], float],
        baud_rate: int | None = None,
    ) -> None:
        self._device = device
        self._incoming, self._outgoing = incoming, outgoing
        self._request_delay, self._reply_delay = _BaudRateDelay(baud_rate), _BaudRateDelay(baud_rate)
        self._now_s = now_s

    def receive(self, piece: bytes, send: Callable[[bytes], object]) -> None:
        """Pass a message to the base on its arrival, and its replies to `send` on theirs."""
        for arrived in self._incoming.carry(piece):
            self._request_delay.carry(arrived, partial(self._reply, send=send))

    def _reply(self, request: bytes, send: Callable[[bytes], object]) -> None:
        for reply in self._device.replies(request, self._now_s()):
            for sent in self._outgoing.carry(reply):
                self._reply_delay.carry(sent, send)

    async def keep_ticking(self) -> None:
        """Tick the base forever."""
        while True:
            self._device.tick(self._now_s())
            await asyncio.sleep(TICK_S)

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Tick the base for the length of a block."""
        ticking = asyncio.create_task(self.keep_ticking())
        try:
            yield
        finally:
            ticking.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await ticking


async def run(served: AbstractAsyncContextManager[str], vehicle: FreeVehicle, scheme: str = "") -> None:
    """Serve until Ctrl-C or SIGTERM; print the address at the start and the robot's pose at the end.

    Args:
        served: serves for the length of a block, and yields the address.
        vehicle: the robot's vehicle.
        scheme: prefix of the address, such as `udp://`.
    """
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    async with served as address:
        _print(f"{scheme}{address}")
        await ended.wait()
    x_m, y_m, yaw_rad = vehicle.pose
    _print(f"pose {x_m:.4f} m {y_m:.4f} m {math.degrees(yaw_rad):.2f} deg")


def _print(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


@asynccontextmanager
async def on_pty(server: EmulatorServer) -> AsyncIterator[str]:
    """Serve behind a pseudo-terminal for the length of a block; yields the path of its port."""
    if not hasattr(os, "openpty"):
        raise SystemExit("this system has no pseudo-terminals")
    import tty

    loop = asyncio.get_running_loop()
    master, slave = os.openpty()
    try:
        tty.setraw(master)
        tty.setraw(slave)
        os.set_blocking(master, False)

        def send(data: bytes) -> None:
            with contextlib.suppress(BlockingIOError):  # no reader: excess bytes are lost, as on a wire
                os.write(master, data)

        loop.add_reader(master, lambda: server.receive(os.read(master, _MOST_BYTES), send))
        async with server.running():
            yield os.ttyname(slave)
    finally:
        loop.remove_reader(master)
        os.close(master)
        os.close(slave)


@asynccontextmanager
async def on_tcp(server: EmulatorServer, address: Address) -> AsyncIterator[str]:
    """Serve TCP connections for the length of a block; yields `host:port`."""
    connections: dict[asyncio.Task[None] | None, asyncio.StreamWriter] = {}

    async def serve_connection(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connections[task := asyncio.current_task()] = writer
        with contextlib.suppress(ConnectionError):
            while data := await reader.read(_MOST_BYTES):
                server.receive(data, writer.write)
        del connections[task]
        writer.close()

    listener = await asyncio.start_server(serve_connection, *address)
    try:
        async with server.running():
            yield _format(listener.sockets[0].getsockname())
    finally:
        listener.close()
        for writer in connections.values():
            writer.close()
        await asyncio.gather(*filter(None, connections))
        await listener.wait_closed()


class _DatagramServer(asyncio.DatagramProtocol):
    def __init__(self, server: EmulatorServer) -> None:
        self._server = server
        self._transport: asyncio.DatagramTransport

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self._server.receive(data, lambda reply: self._transport.sendto(reply, addr))


@asynccontextmanager
async def on_udp(server: EmulatorServer, address: Address) -> AsyncIterator[str]:
    """Serve datagrams for the length of a block; yields `host:port`."""
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(lambda: _DatagramServer(server), local_addr=address)
    try:
        async with server.running():
            yield _format(transport.get_extra_info("sockname"))
    finally:
        transport.close()


def _format(address: Address) -> str:
    return f"{address[0]}:{address[1]}"
