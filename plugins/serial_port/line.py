"""A communication resource over a byte stream that may be lost and reopened."""

from __future__ import annotations

from collections.abc import Generator
from typing import Final

from eal_actors.plugin import (
    Activity,
    ArgumentError,
    Clock,
    DataType,
    EALData,
    FactoryPlugin,
    ReopeningPort,
    Resource,
    ResourceType,
    UnavailableError,
    ValueInfo,
    command,
    setting,
)

MOST_BYTES: Final = 1 << 20
"""Size of the receive buffer; further bytes wait in the operating system or at the sender."""
LOOK_S: Final = 0.01
"""Poll interval during a read or a write."""
TIMEOUT: Final = ValueInfo(DataType.DOUBLE, "s", 0, 3600)

_IDLE_LOOK_S: Final = 0.05
_PIECE_BYTES: Final = 65536


class Line(Resource):
    """Sends and receives bytes; get_status: the number of bytes to read.

    Unread bytes stay when the port reopens: they may be the peer's last answer before it closed.

    Args:
        timeout_s: longest wait of a read or a write.
    """

    types = ResourceType.COMMUNICATION

    timeout_s: float = setting(TIMEOUT, "Longest wait of a read or a write.")

    def __init__(self, port: ReopeningPort, clock: Clock, timeout_s: float) -> None:
        self.port = port
        self._clock = clock
        self.timeout_s = timeout_s
        self._waiting = bytearray()
        self._readers: list[object] = []
        self._writers: list[object] = []

    def not_ready(self) -> str | None:
        """Return why the port is not open."""
        return self.port.why_not_ready()

    def get_status(self) -> int:
        """Return the number of bytes to read."""
        self._receive()
        return len(self._waiting)

    def read_comm(self, length: int) -> Generator[float, None, bytes]:
        """Return `length` bytes, or after the time-out those that have arrived (Source: thesis B.2.3.5).

        Reads are served in order.

        Raises:
            ArgumentError: the length is below 0, or exceeds the receive buffer.
            NotReadyError: the port is absent.
        """
        if not 0 <= length <= MOST_BYTES:
            raise ArgumentError(f"a read is of 0..{MOST_BYTES} bytes, not {length}")
        return self._read(length)

    def write_comm(self, data: EALData, length: int) -> Activity:
        """Write the first `length` bytes and return `length`; writes never interleave.

        Raises:
            ArgumentError: the data is shorter.
            NotReadyError: the port is absent or was lost; some bytes may have been sent.
            UnavailableError: the peer did not accept all bytes within the time-out.
        """
        payload = bytes(data.payload)
        if not 0 <= length <= len(payload):
            raise ArgumentError(f"cannot write {length} bytes of {len(payload)}")
        return self._write(payload[:length])

    @command("discard")
    def discard(self) -> None:
        """Discard all unread bytes."""
        self._receive()
        self._waiting.clear()

    def background(self) -> Activity:
        """Receive continuously, to prevent an overflow and to detect a lost port without a call."""
        while True:
            try:
                self._receive()
            except UnavailableError:  # not_ready reports it
                self.port.why_not_ready()
            yield _IDLE_LOOK_S

    def send(self, data: memoryview) -> int:
        """Send as many bytes as possible now; return their number."""
        return self.port.write(bytes(data[:_PIECE_BYTES]))

    def _receive(self) -> None:
        while room := min(MOST_BYTES - len(self._waiting), _PIECE_BYTES):
            piece = self.port.read(room)
            self._waiting += piece
            if len(piece) < room:
                return

    def _read(self, length: int) -> Generator[float, None, bytes]:
        turn, end_s = object(), self._clock.now() + self.timeout_s
        self._readers.append(turn)
        try:
            while True:
                self._receive()
                is_late = (left_s := end_s - self._clock.now()) <= 0
                if self._readers[0] is turn and (data := self._take(length, is_late=is_late)) is not None:
                    return data
                if is_late:
                    return self._nothing()
                yield min(LOOK_S, left_s)
        finally:
            self._readers.remove(turn)

    def _take(self, length: int, *, is_late: bool) -> bytes | None:
        """Return what a read gets now; None if it has to wait."""
        if len(self._waiting) < length and not is_late:
            return None
        data = bytes(self._waiting[:length])
        del self._waiting[:length]
        return data

    def _nothing(self) -> bytes:
        """Return what a read gets after the time-out if it has not had its turn."""
        return b""

    def _write(self, data: bytes) -> Generator[float, None, int]:
        turn, rest, end_s = object(), memoryview(data), self._clock.now() + self.timeout_s
        self._writers.append(turn)
        try:
            while self._writers[0] is not turn or rest:
                if self._writers[0] is turn and (sent := self.send(rest)):
                    rest, end_s = rest[sent:], self._clock.now() + self.timeout_s
                    if not rest:
                        break
                if (left_s := end_s - self._clock.now()) <= 0:
                    raise UnavailableError(
                        f"{self.port.name} took only {len(data) - len(rest)} of {len(data)} bytes, and then none for "
                        f"{self.timeout_s:g} s"
                    )
                yield min(LOOK_S, left_s)
            return len(data)
        finally:
            self._writers.remove(turn)


class PortPlugin(FactoryPlugin):
    """A plugin with one resource, which the settings name."""

    def __init__(self, name: str, line: Line) -> None:
        super().__init__({name: lambda: line})
        self.line = line


def disconnect(plugin: PortPlugin) -> None:
    """Close the port."""
    plugin.line.port.close()
