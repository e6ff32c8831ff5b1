"""A UDP port as a BytePort: a write is a datagram, a read what datagrams brought."""

from __future__ import annotations

import contextlib
import select
import socket

_MOST_BYTES = 65536


class UdpPort:
    """Datagrams to and from one address; none of its methods waits.

    That nobody is there is no error, for datagrams may be lost: whoever asks hears nothing.

    Args:
        host: name or address of the other end.
        port: its port.

    Raises:
        OSError: there is no such host, or no way to it.

    Thread: blocks the caller while the name is looked up.
    """

    def __init__(self, host: str, port: int) -> None:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, kind, protocol)
        try:
            self._socket.setblocking(False)
            self._socket.connect(address)
        except BaseException:
            self._socket.close()
            raise

    @property
    def in_waiting(self) -> int:
        """Return 1 if something can be read, else 0."""
        return len(select.select([self._socket], [], [], 0)[0])

    def read(self, size: int = _MOST_BYTES) -> bytes:
        """Return the next datagram, of which what is beyond the size is lost; empty for none."""
        try:
            return self._socket.recv(size)
        except (BlockingIOError, ConnectionRefusedError):
            return b""

    def write(self, data: bytes) -> int:
        """Send a datagram."""
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            self._socket.send(data)
        return len(data)

    def reset_input_buffer(self) -> None:
        """Forget what has arrived."""
        while self.in_waiting:
            self.read()

    def close(self) -> None:
        """Let go of the port."""
        self._socket.close()
