"""The connection to a Roomba: the interface of every link, and the serial link."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final, Protocol, TypeVar

from typing_extensions import override

from eal_actors.plugin import BytePort, PluginContext, ReopeningPort, UnavailableError, open_serial

from .bodies import RoombaBody
from .motes import ByteEmulator
from .settings import SIMULATED

_T = TypeVar("_T")

_CHUNK_BYTES: Final = 4096


class RoombaLink(Protocol):
    """Carries the interface's bytes. No method blocks. Thread: one at a time; its owner locks it."""

    @property
    def name(self) -> str:
        """Its name in messages, such as `/dev/ttyUSB0`."""
        ...

    @property
    def openings(self) -> int:
        """Number of openings; after a reopening the port may have another Roomba."""
        ...

    @property
    def repeats(self) -> int:
        """Number of transmissions of a command that must arrive."""
        ...

    @property
    def reading_lasts_s(self) -> float:
        """Minimum validity of a reading, because replies may be lost."""
        ...

    @property
    def unsure_s(self) -> tuple[float, float]:
        """The times between which the latest commands came; the second one is infinite until they have come."""
        ...

    @property
    def is_busy(self) -> bool:
        """Whether the queue is not empty; then `receive` must be called often."""
        ...

    def why_not_ready(self) -> str | None:
        """Return why it cannot be used at present; None if it can."""
        ...

    def send(self, data: bytes, *, supersedes: bool = False) -> None:
        """Send one command; one that supersedes drops queued commands with the same op code.

        Raises:
            UnavailableError: the queue is full, the peer does not acknowledge, or the port is broken.
        """
        ...

    def ask(self, data: bytes) -> None:
        """Send a question, once and at once; it may be lost.

        Raises:
            UnavailableError: the port is broken.
        """
        ...

    def urge(self, data: bytes) -> None:
        """Send bytes at once, and drop the queue.

        Raises:
            UnavailableError: the port is broken.
        """
        ...

    def receive(self) -> bytes:
        """Return the bytes received since the last call.

        Raises:
            UnavailableError: the peer does not acknowledge, or the port is broken.
        """
        ...

    def pull_device_detect(self, *, low: bool) -> None:
        """Pull the Roomba's device detect line low, or release it, if the link has this line."""
        ...

    def close(self) -> None:
        """Close it; no effect if it is closed."""
        ...


class Port(BytePort, Protocol):
    """A port of a link: a ReopeningPort, or one in memory."""

    @property
    def name(self) -> str:
        """Its name in messages."""
        ...

    @property
    def openings(self) -> int:
        """Number of openings."""
        ...

    def why_not_ready(self) -> str | None:
        """Return why it cannot be used now; None while it is open."""
        ...

    def use(self, action: Callable[[BytePort], _T]) -> _T:
        """Call the action with the open port, exclusively."""
        ...


class PortLink(RoombaLink):
    """A link at a port.

    Args:
        port: its read must not wait.
    """

    def __init__(self, port: Port) -> None:
        self._port = port

    @property
    @override
    def name(self) -> str:
        return self._port.name

    @property
    @override
    def openings(self) -> int:
        return self._port.openings

    @override
    def why_not_ready(self) -> str | None:
        return self._port.why_not_ready()

    @override
    def close(self) -> None:
        self._port.close()


class SerialLink(PortLink):
    """A link over the Roomba's cable at a serial port."""

    repeats: Final = 1
    reading_lasts_s: Final = 0.0
    unsure_s: Final = (0.0, 0.0)
    is_busy: Final = False

    @override
    def send(self, data: bytes, *, supersedes: bool = False) -> None:  # nothing waits
        self._port.write(data)

    @override
    def ask(self, data: bytes) -> None:
        self._port.write(data)

    @override
    def urge(self, data: bytes) -> None:
        self._port.write(data)

    @override
    def receive(self) -> bytes:
        received = bytearray()
        while chunk := self._port.read(_CHUNK_BYTES):
            received += chunk
        return bytes(received)

    def pull_device_detect(self, *, low: bool) -> None:
        """Set both modem lines: a cable uses one of them. A pseudo-terminal and a socket have none."""

        def pull(port: Any) -> None:
            for line in ("rts", "dtr"):  # a line that is on is low at the connector
                with suppress(OSError, AttributeError, ValueError):
                    setattr(port, line, low)

        with suppress(UnavailableError):
            self._port.use(pull)


def open_port(
    context: PluginContext, url: str, baudrate: int, emulate: Callable[[RoombaBody], ByteEmulator]
) -> ReopeningPort:
    """Open a serial port that is reopened when it vanishes; an absent one is no error.

    Args:
        context: of the plugin, with the settings `dtr` and `rts`.
        url: a device path, any URL of pyserial, or a simulated port, such as `sim://world`.
        baudrate: bits a second.
        emulate: creates the emulator for a simulated robot's body.

    Raises:
        PluginError: it can never be opened.

    Thread: the robot's; opening a port of the network may take seconds.
    """

    def open_it() -> BytePort:
        if url.startswith(SIMULATED):
            return context.simulated_port(url, "roomba", emulate)
        return open_serial(url, baudrate=baudrate, dtr=context.settings.dtr, rts=context.settings.rts)

    port = ReopeningPort(open_it, context.clock, url)
    port.open()
    return port
