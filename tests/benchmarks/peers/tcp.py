"""Raw TCP: a byte that says what is wanted, and as many bytes back as that has. The reference of all ratios."""

from __future__ import annotations

import socket
import socketserver
import statistics
from typing import Final

from tests.benchmarks.peers.peer import FRAME, GIVE_UP_S, HOST, ROBOTS, VALUE, SyncPeer, timed

_ANSWERS: Final = {b"g": VALUE, b"c": b"\x01", b"f": FRAME}


class _Handler(socketserver.BaseRequestHandler):
    def handle(self) -> None:
        peer: socket.socket = self.request
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while wanted := peer.recv(1):
            peer.sendall(_ANSWERS[wanted])


class TcpServer(socketserver.ThreadingTCPServer):
    """A thread for each connection."""

    allow_reuse_address = True
    daemon_threads = True
    request_queue_size = 2 * ROBOTS

    def __init__(self, port: int) -> None:
        super().__init__((HOST, port), _Handler)


class TcpClient:
    """One connection."""

    def __init__(self, port: int) -> None:
        self.peer = socket.create_connection((HOST, port), GIVE_UP_S)
        self.peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, wanted: bytes) -> None:
        self.peer.sendall(wanted)

    def receive(self, wanted: bytes) -> None:
        left = len(_ANSWERS[wanted])
        buffer = memoryview(bytearray(left))
        while left:
            count = self.peer.recv_into(buffer[len(buffer) - left :])
            if not count:
                raise ConnectionError("the server is gone")
            left -= count

    def ask(self, wanted: bytes) -> None:
        self.send(wanted)
        self.receive(wanted)

    def get(self) -> None:
        self.ask(b"g")

    def command(self) -> None:
        self.ask(b"c")

    def frame(self) -> None:
        self.ask(b"f")

    def close(self) -> None:
        self.peer.close()


class Tcp(SyncPeer):
    """The least that a round trip can cost."""

    name = "raw TCP"

    def handle(self) -> TcpClient:
        return TcpClient(self.port)

    def fan_out(self, count: int) -> float:
        """A connection to each robot; all are asked before the first answer is read."""
        robots = [self.handle() for _ in range(ROBOTS)]

        def once() -> None:
            for robot in robots:
                robot.send(b"c")
            for robot in robots:
                robot.receive(b"c")

        try:
            once()
            return statistics.median(timed(once) for _ in range(count))
        finally:
            for robot in robots:
                robot.close()

    def try_once(self) -> None:
        try:
            self._own.get()
        except OSError:
            self._own.close()
            self._own = self.handle()
            self._own.get()

    def close(self) -> None:
        self._own.close()
        super().close()
