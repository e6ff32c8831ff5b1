"""The way to a Roomba: bytes there and bytes back, whatever carries them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final, Protocol, TypeVar

from eal_actors.plugin import BytePort, PluginContext, ReopeningPort, UnavailableError, open_serial

from .bodies import RoombaBody
from .motes import ByteEmulator
from .settings import SIMULATED

_T = TypeVar("_T")

_CHUNK_BYTES: Final = 4096


class RoombaLink(Protocol):
    """What carries the interface's bytes. Nothing of it blocks. Thread: one at a time; its owner locks it."""

    @property
    def name(self) -> str:
        """What it goes through, for messages, such as `/dev/ttyUSB0`."""
        ...

    @property
    def openings(self) -> int:
        """How often it has been opened; when that changes, what is at the other end may be new."""
        ...

    @property
    def repeats(self) -> int:
        """How often to say what must not be lost on the way."""
        ...

    @property
    def reading_lasts_s(self) -> float:
        """How long a reading must count at least, for the replies that are lost on the way."""
        ...

    @property
    def is_busy(self) -> bool:
        """Whether something waits to be sent, for which `receive` is to be called often."""
        ...

    def why_not_ready(self) -> str | None:
        """Return why it cannot be used at present; None if it can."""
        ...

    def send(self, data: bytes, *, supersedes: bool = False) -> None:
        """Send bytes.

        Args:
            data: one command.
            supersedes: whether commands with the same op code that still wait are out of date.

        Raises:
            UnavailableError: they do not go out.
        """
        ...

    def urge(self, data: bytes) -> None:
        """Send bytes at once, in place of whatever waits to be sent.

        Raises:
            UnavailableError: they do not go out.
        """
        ...

    def receive(self) -> bytes:
        """Return what has come in since the last call; empty for nothing.

        Raises:
            UnavailableError: the link is broken.
        """
        ...

    def pull_device_detect(self, *, low: bool) -> None:
        """Pull the Roomba's device detect line low, or let go of it, where there is such a line."""
        ...

    def close(self) -> None:
        """Let go of it; harmless if it is closed."""
        ...


class Port(BytePort, Protocol):
    """What links use of a port: it is a ReopeningPort, or one in memory."""

    @property
    def name(self) -> str:
        """What messages call it."""
        ...

    @property
    def openings(self) -> int:
        """How often it has been opened."""
        ...

    def why_not_ready(self) -> str | None:
        """Return why it cannot be used now; None while it is open."""
        ...

    def use(self, action: Callable[[BytePort], _T]) -> _T:
        """Do something with the open port while nobody else does."""
        ...


class SerialLink:
    """A Link over a serial port.

    Args:
        port: its read must not wait.
    """

    repeats: Final = 1
    reading_lasts_s: Final = 0.0
    is_busy: Final = False

    def __init__(self, port: Port) -> None:
        self._port = port

    @property
    def name(self) -> str:
        """See Link."""
        return self._port.name

    @property
    def openings(self) -> int:
        """See Link."""
        return self._port.openings

    def why_not_ready(self) -> str | None:
        """See Link."""
        return self._port.why_not_ready()

    def send(self, data: bytes, *, supersedes: bool = False) -> None:  # noqa: ARG002  # nothing waits
        """See Link."""
        self._port.write(data)

    def urge(self, data: bytes) -> None:
        """See Link: nothing waits."""
        self._port.write(data)

    def receive(self) -> bytes:
        """See Link."""
        return self._port.read(_CHUNK_BYTES)

    def pull_device_detect(self, *, low: bool) -> None:
        """See Link: by the modem lines, of which a cable uses one. A pseudo-terminal and a socket have none."""

        def pull(port: Any) -> None:
            for line in ("rts", "dtr"):  # a line that is on is low at the connector
                with suppress(OSError, AttributeError, ValueError):
                    setattr(port, line, low)

        with suppress(UnavailableError):
            self._port.use(pull)

    def close(self) -> None:
        """See Link."""
        self._port.close()


def open_port(
    context: PluginContext, url: str, baudrate: int, emulate: Callable[[RoombaBody], ByteEmulator]
) -> ReopeningPort:
    """Open a serial port that is reopened when it vanishes; an absent one is no error.

    Args:
        context: of the plugin.
        url: a device path, any URL of pyserial, or a simulated port, such as `sim://world`.
        baudrate: bits a second.
        emulate: makes the emulator for a simulated robot's body.

    Raises:
        PluginError: it can never be opened.

    Thread: the robot's; opening a port of the network may take seconds.
    """

    def open_it() -> BytePort:
        if url.startswith(SIMULATED):
            return context.simulated_port(url, "roomba", emulate)
        return open_serial(url, baudrate=baudrate)

    port = ReopeningPort(open_it, context.clock, url)
    port.open()
    return port
