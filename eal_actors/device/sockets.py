"""TCP and UDP sockets as byte ports (see `eal_actors.device.ports.BytePort`)."""

from __future__ import annotations

import selectors
import socket
import struct
from typing import Final

from eal_actors.kernel.clock import REAL_TIME

_WRITE_TIMEOUT_S: Final = 0.2
_CONNECT_TIMEOUT_S: Final = 5.0
_MOST_WAITING: Final = 65536
_PEER_LOST_S: Final = 10  # a peer that loses its power sends nothing; TCP gives it up after this time


def open_tcp(host: str, port: int, timeout_s: float = _CONNECT_TIMEOUT_S) -> TcpPort:
    """Connect to a TCP server; OSError if it does not answer, refuses, or has no such name.

    Thread: blocks the caller for `timeout_s` at most, and as long as it takes to look up the name.
    """
    return TcpPort(socket.create_connection((host, port), timeout_s))


class TcpPort:
    """A TCP connection as a BytePort: it sends bytes at once and detects a peer that is gone.

    The port owns the connected socket from now on.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # a stop must not wait for more bytes
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in (
            ("TCP_KEEPIDLE", _PEER_LOST_S // 2),
            ("TCP_KEEPINTVL", 1),
            ("TCP_KEEPCNT", _PEER_LOST_S // 2),
            ("TCP_USER_TIMEOUT", _PEER_LOST_S * 1000),
        ):
            if hasattr(socket, option):  # not every system has them
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)

    def fileno(self) -> int:
        """Return the descriptor, for a `select` that waits for bytes."""
        return self._socket.fileno()

    @property
    def in_waiting(self) -> int:
        """The number of bytes that can be read, at most 64 KiB."""
        try:
            return len(self._socket.recv(_MOST_WAITING, socket.MSG_PEEK))
        except BlockingIOError:
            return 0

    def read(self, size: int = 1) -> bytes:
        """Return the received bytes, at most `size`; raises OSError when the connection has ended."""
        try:
            data = self._socket.recv(size)
        except BlockingIOError:
            return b""
        if not data and size > 0:
            raise ConnectionError("the other end has closed the connection")
        return data

    def write(self, data: bytes) -> int:
        """Send all bytes, or raise OSError after 0.2 s."""
        sent, end_s = 0, REAL_TIME.now() + _WRITE_TIMEOUT_S
        while (sent := sent + self.write_some(data[sent:])) < len(data):
            left_s = end_s - REAL_TIME.now()
            if left_s <= 0 or not self._takes_more(left_s):
                raise TimeoutError(f"took only {sent} of {len(data)} bytes in {_WRITE_TIMEOUT_S} s")
        return len(data)

    def _takes_more(self, timeout_s: float) -> bool:
        """Wait until bytes can be sent; return whether they can."""
        with selectors.DefaultSelector() as selector:  # `select` knows no descriptors from 1024 on
            selector.register(self._socket, selectors.EVENT_WRITE)
            return bool(selector.select(timeout_s))

    def write_some(self, data: bytes) -> int:
        """Send as many bytes as possible without waiting; return how many."""
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0

    def reset_input_buffer(self) -> None:
        """Discard the received bytes."""
        while self.read(65536):
            pass

    def reset_output_buffer(self) -> None:
        """Discard the bytes that the other end has not accepted when the port is closed."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class UdpPort:
    """A UDP socket as a BytePort: a read or a write is one datagram. It never blocks.

    An absent peer is no error, because datagrams may be lost. Datagrams from others than the `host` are ignored; a
    `local_port` of 0 takes any. Raises OSError if the host is unknown or unreachable, or the local port is in use.
    Thread: the constructor blocks while the name is looked up.
    """

    def __init__(self, host: str, port: int, local_port: int = 0) -> None:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, kind, protocol)
        try:
            self._socket.setblocking(False)
            self._socket.bind(("", local_port))
            self._socket.connect(address)
        except BaseException:
            self._socket.close()
            raise

    @property
    def in_waiting(self) -> int:
        """Return 1 if a datagram can be read, else 0."""
        while True:
            try:
                self._socket.recv(_MOST_WAITING, socket.MSG_PEEK)
            except BlockingIOError:
                return 0
            except ConnectionRefusedError:  # the peer of an earlier datagram did not listen; others may wait behind it
                continue
            return 1

    def read(self, size: int = 65536) -> bytes:  # noqa: ARG002  # a datagram is read as a whole
        """Return the next datagram; empty for none."""
        try:
            return self._socket.recv(65536)
        except (BlockingIOError, ConnectionRefusedError):  # the peer of an earlier datagram did not listen
            return b""

    def write(self, data: bytes) -> int:
        """Send one datagram; return 0 if it could not be sent now."""
        try:
            return self._socket.send(data)
        except (BlockingIOError, ConnectionRefusedError):  # the second reports an earlier datagram
            return 0

    def reset_input_buffer(self) -> None:
        """Discard all received datagrams."""
        while self.in_waiting:
            self.read()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
