"""The way to the Roomba: bytes there and bytes back, whatever carries them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Protocol

import serial

from eal_actors.plugin import BytePort, PluginContext, PluginError, UnavailableError

from .emulator import Body, RoombaEmulator

if TYPE_CHECKING:
    from .plugin import Settings

_WRITE_TIMEOUT_S: Final = 0.2
_CHUNK_BYTES: Final = 4096


class Link(Protocol):
    """What carries the interface's bytes. Nothing of it blocks. Thread: one at a time; its owner locks it."""

    @property
    def name(self) -> str:
        """What it goes through, for messages, such as `/dev/ttyUSB0`."""
        ...

    def send(self, data: bytes) -> None:
        """Send bytes.

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

    def close(self) -> None:
        """Let go of it; harmless if it is closed."""
        ...


class SerialLink:
    """A Link over a serial port.

    Args:
        port: an open port, of pyserial or simulated; its read must not wait.
        name: see Link.
    """

    def __init__(self, port: BytePort, name: str) -> None:
        self._port = port
        self._name = name

    @property
    def name(self) -> str:
        """See Link."""
        return self._name

    def send(self, data: bytes) -> None:
        """See Link."""
        try:
            self._port.write(data)
        except OSError as error:  # pyserial's errors are among them
            raise UnavailableError(f"cannot write to the serial port {self._name}: {error}") from error

    def receive(self) -> bytes:
        """See Link."""
        try:
            return bytes(self._port.read(_CHUNK_BYTES))
        except OSError as error:
            raise UnavailableError(f"cannot read from the serial port {self._name}: {error}") from error

    def close(self) -> None:
        """See Link."""
        self._port.close()


def open_port(context: PluginContext, settings: Settings) -> BytePort:
    """Open the serial port that the settings name: a device path, any URL that pyserial knows, or a simulated one.

    Raises:
        PluginError: it cannot be opened.

    Thread: the robot's; opening a port of the network may take seconds.
    """
    if settings.port.startswith("sim:"):
        return context.simulated_port(settings.port, "roomba", _emulator)
    try:
        port: BytePort = serial.serial_for_url(
            settings.port,
            baudrate=settings.baudrate,
            timeout=0,
            write_timeout=_WRITE_TIMEOUT_S,
            exclusive=True,  # a second owner would take readings, and so travel, away from the first
        )
        return port
    except (OSError, ValueError) as error:
        raise PluginError(f"robot {context.robot!r}: cannot open the serial port {settings.port}: {error}") from error


def _emulator(body: Body) -> RoombaEmulator:
    """Return the emulator for a simulated body, whose time goes in ticks that may be longer than the pauses."""
    return RoombaEmulator(body, mode_pause_s=0.0)
