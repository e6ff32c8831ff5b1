"""Datagrams: a communication resource over UDP, where bytes come and go in pieces that stay whole."""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Generator
from typing import Final

from eal_actors.plugin import Activity, ArgumentError, Clock, EALData, ReopeningPort, UnavailableError

from ..serial_port.line import LOOK_S, Line

MOST_BYTES: Final = 65507
"""The longest datagram there can be over IPv4."""
_MOST_WAITING: Final = 1024


class UdpPort:
    """A UDP socket as a BytePort, for a ReopeningPort; a read or a write is of one datagram.

    Args:
        host: the other end; what others send is not heard.
        port: its port.
        local_port: the port at this end; 0 for any.

    Raises:
        OSError: there is no such host, or no way to it, or the local port is taken.
    """

    in_waiting = 0  # nobody asks

    def __init__(self, host: str, port: int, local_port: int) -> None:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, kind, protocol)
        try:
            self._socket.setblocking(False)
            self._socket.bind(("", local_port))
            self._socket.connect(address)
        except OSError:
            self._socket.close()
            raise

    def read(self, size: int = 1) -> bytes:  # noqa: ARG002  # datagrams come whole
        """Return the next datagram; empty for none."""
        try:
            return self._socket.recv(65536)
        except (BlockingIOError, ConnectionRefusedError):  # that nobody listened is no news: UDP promises nothing
            return b""

    def write(self, data: bytes) -> int:
        """Send one datagram; return 0 if it does not go out now."""
        try:
            return self._socket.send(data)
        except (BlockingIOError, ConnectionRefusedError):  # the latter is about an earlier one: send it again
            return 0

    def reset_input_buffer(self) -> None:
        """Forget what has arrived."""
        while self.read():
            pass

    def close(self) -> None:
        """Let go of it."""
        self._socket.close()


class Datagrams(Line):
    """Datagrams there and back, each whole or not at all; get_status answers how many bytes wait to be read.

    Args:
        port: of UdpPorts.
        clock: the fleet's clock.
        timeout_s: how long a read waits at most.
    """

    def __init__(self, port: ReopeningPort, clock: Clock, timeout_s: float) -> None:
        super().__init__(port, clock, timeout_s)
        self._datagrams: deque[bytes] = deque(maxlen=_MOST_WAITING)  # the oldest are lost first, as with UDP itself

    def get_status(self) -> int:
        """Return how many bytes wait to be read, of all datagrams together."""
        self._take_in()
        return sum(map(len, self._datagrams))

    def discard(self) -> None:
        """Forget what has come and was not read."""
        self._take_in()
        self._datagrams.clear()

    def read_comm(self, length: int) -> Generator[float, None, bytes]:
        """Return the next datagram, as soon as it is there.

        Raises:
            ArgumentError: it is longer than `length`; it stays for the next read.
            NotReadyError: the host cannot be reached.
            UnavailableError: none came within the timeout.
        """
        return super().read_comm(length)

    def write_comm(self, data: EALData, length: int) -> Activity:
        """Send the first `length` bytes as one datagram, which may get lost, and return how many they were.

        Raises:
            ArgumentError: the data has not so many, or no datagram can hold them.
            NotReadyError: the host cannot be reached.
        """
        if length > MOST_BYTES:
            raise ArgumentError(f"a datagram holds at most {MOST_BYTES} bytes, not {length}")
        return super().write_comm(data, length)

    def send(self, data: memoryview) -> int:
        """Send the datagram."""
        return self._port.write(bytes(data))

    def _take_in(self) -> None:
        while datagram := self._port.read():
            self._datagrams.append(datagram)

    def _read(self, length: int) -> Generator[float, None, bytes]:
        turn, end_s = object(), self._clock.now() + self._timeout_s
        self._readers.append(turn)
        try:
            while True:
                self._take_in()
                if self._readers[0] is turn and self._datagrams:
                    if (size := len(self._datagrams[0])) > length:
                        raise ArgumentError(f"the next datagram has {size} bytes, and {length} are wanted; it stays")
                    return self._datagrams.popleft()
                if (left_s := end_s - self._clock.now()) <= 0:
                    raise UnavailableError(f"no datagram came from {self._port.name} within {self._timeout_s:g} s")
                yield min(LOOK_S, left_s)
        finally:
            self._readers.remove(turn)
