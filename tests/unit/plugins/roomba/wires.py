"""Real wires to the emulator: a pseudo-terminal, and sockets with a Roomba behind each connection."""

from __future__ import annotations

import os
import select
import socketserver
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager

from eal_actors.kernel.clock import SystemClock
from plugins.roomba.bodies import FreeRoombaBody
from plugins.roomba.sci import WHEELBASE_M
from plugins.roomba.sci_emulator import SciEmulator


def new_emulator(clock: SystemClock) -> SciEmulator:
    """Return a Roomba in free space, which does not mind that an operating system delays bytes."""
    return SciEmulator(FreeRoombaBody(clock.now, WHEELBASE_M), mode_pause_s=0.0)


@contextmanager
def roomba_on_a_pty() -> Iterator[tuple[str, SciEmulator]]:
    """Run an emulator behind a pseudo-terminal for the length of a `with` block; gives the path of its port.

    At the end of the block the emulator has heard all that was sent.
    """
    clock = SystemClock()
    emulator = new_emulator(clock)
    master, slave = os.openpty()
    ended, end = os.pipe()
    tty.setraw(master)
    tty.setraw(slave)

    def serve() -> None:
        while master in select.select([master, ended], [], [])[0]:  # to the last byte, and then the end
            os.write(master, emulator.feed(os.read(master, 4096), clock.now()))

    thread = threading.Thread(target=serve, name="roomba on a pty")
    thread.start()
    try:
        yield os.ttyname(slave), emulator
    finally:
        os.write(end, b".")
        thread.join()
        for descriptor in (master, slave, ended, end):
            os.close(descriptor)


class _Connection(socketserver.BaseRequestHandler):
    def handle(self) -> None:
        clock = SystemClock()
        emulator = new_emulator(clock)
        while data := self.request.recv(4096):
            self.request.sendall(emulator.feed(data, clock.now()))


class _Server(socketserver.ThreadingTCPServer):
    block_on_close = True


@contextmanager
def roombas_on_sockets() -> Iterator[str]:
    """Serve emulators for the length of a `with` block, a new one to each connection; gives the URL of their port."""
    with _Server(("127.0.0.1", 0), _Connection) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,), name="roombas on sockets")
        thread.start()
        host, port = server.server_address[:2]
        try:
            yield f"socket://{host!s}:{port}"
        finally:
            server.shutdown()
            thread.join()
