"""UdpListener: a UDP port at which a vehicle sends, as a port of bytes."""

from __future__ import annotations

import socket
from typing import Any, Final

from . import protocol

_MOST_STRANGERS: Final = 500
"""Datagrams of others that a read skips, so that a flood keeps nothing back."""


class UdpListener:
    """A BytePort that listens: it answers the vehicle's last address. Datagrams are read as bytes.

    Args:
        system: of the vehicle; other senders are not answered.
    """

    def __init__(self, host: str, port: int, system: int) -> None:
        self._system = system
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.bind((host, port))
        except BaseException:
            self._socket.close()
            raise
        self._peer: Any = None
        self.in_waiting = 0

    def read(self, size: int = 1) -> bytes:  # noqa: ARG002  # a datagram is read as a whole
        """Return the next datagram; empty for none."""
        for _ in range(_MOST_STRANGERS):
            try:
                data, sender = self._socket.recvfrom(65536)
            except (BlockingIOError, ConnectionRefusedError):
                return b""
            if protocol.begins_frame_of(data, self._system):
                self._peer = sender
            if self._peer in (None, sender):  # the middle of a frame, from a bridge that cuts the bytes anywhere
                return data
        return b""

    def write(self, data: bytes) -> int:
        """Send a datagram to the vehicle; if it has not sent yet, it is dropped."""
        try:
            return 0 if self._peer is None else self._socket.sendto(data, self._peer)
        except (BlockingIOError, ConnectionRefusedError):
            return 0

    def reset_input_buffer(self) -> None:
        """Discard all received datagrams."""
        while self.read():
            pass

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
