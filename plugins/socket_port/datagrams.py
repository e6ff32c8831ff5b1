"""A communication resource over UDP: each read or write is one datagram."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator
from typing import Final

from eal_actors.plugin import Activity, ArgumentError, Clock, EALData, ReopeningPort, UnavailableError

from ..serial_port.line import Line

MOST_BYTES: Final = 65507
"""The longest datagram over IPv4."""

_BUFFERED_DATAGRAMS: Final = 1024


class Datagrams(Line):
    """Sends and receives datagrams; get_status: the number of bytes to read.

    Args:
        port: opens UdpPorts.
        timeout_s: longest wait of a read.
    """

    def __init__(self, port: ReopeningPort, clock: Clock, timeout_s: float) -> None:
        super().__init__(port, clock, timeout_s)
        self._datagrams: deque[bytes] = deque(maxlen=_BUFFERED_DATAGRAMS)  # when full, the oldest is lost

    def get_status(self) -> int:
        """Return the number of bytes to read, of all datagrams."""
        self._receive()
        return sum(map(len, self._datagrams))

    def discard(self) -> None:
        """Discard all unread bytes."""
        self._receive()
        self._datagrams.clear()

    def read_comm(self, length: int) -> Generator[float, None, bytes]:
        """Return the next datagram; wait for it if there is none.

        Raises:
            ArgumentError: it is longer than `length`; it stays for the next read.
            NotReadyError: the host cannot be reached.
            UnavailableError: none came within the timeout.
        """
        return super().read_comm(length)

    def write_comm(self, data: EALData, length: int) -> Activity:
        """Send the first `length` bytes as one datagram, which may get lost; return `length`.

        Raises:
            ArgumentError: the data is shorter, or too long for a datagram.
            NotReadyError: the host cannot be reached.
        """
        if length > MOST_BYTES:
            raise ArgumentError(f"a datagram holds at most {MOST_BYTES} bytes, not {length}")
        return super().write_comm(data, length)

    def send(self, data: memoryview) -> int:
        """Send the datagram."""
        return self.port.write(bytes(data))

    def _receive(self) -> None:
        while datagram := self.port.read():
            self._datagrams.append(datagram)

    def _take(self, length: int, *, is_late: bool) -> bytes | None:  # noqa: ARG002  # as in Line
        if not self._datagrams:
            return None
        if (size := len(self._datagrams[0])) > length:
            raise ArgumentError(f"the next datagram has {size} bytes, more than the {length} requested; it stays")
        return self._datagrams.popleft()

    def _nothing(self) -> bytes:
        raise UnavailableError(f"no datagram came from {self.port.name} within {self.timeout_s:g} s")
