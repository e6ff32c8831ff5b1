"""The serial_port plugin: any serial port as a communication resource (Source: thesis §4.2.1, §4.4.3)."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

from eal_actors.plugin import (
    ArgumentError,
    BytePort,
    Clock,
    DataType,
    Field,
    PluginContext,
    PluginSettingsModel,
    ReopeningPort,
    ValueInfo,
    config,
    config_setter,
    open_serial,
)

from .line import LOOK_S, Line, PortPlugin, disconnect

__all__ = ["Settings", "connect", "disconnect"]

try:
    from termios import error as TerminalError  # noqa: N812  # a class
except ModuleNotFoundError:  # a system without POSIX terminals
    TerminalError = OSError  # type: ignore[misc,assignment]
_UNSUPPORTED: Final = (OSError, ValueError, TerminalError)
_BAUDRATE: Final = ValueInfo(DataType.INT, "Bd", 50, 4_000_000)
_BYTESIZE: Final = ValueInfo(DataType.INT, "bit", choices=(5, 6, 7, 8))
_PARITY: Final = ValueInfo(DataType.CHAR, choices=("N", "E", "O", "M", "S"))
_LEVEL: Final = ValueInfo(DataType.BOOL, description="whether the line is active")
_STOPBITS: Final = ValueInfo(DataType.INT, "bit", choices=(1, 2))


class Settings(PluginSettingsModel):
    """The plugin's settings in the fleet file."""

    port: str = Field(min_length=1)
    """A device path, such as /dev/ttyUSB0, or a URL of pyserial, such as socket://host:port."""
    baudrate: int = Field(default=9600, ge=50, le=4_000_000)
    """Bits per second."""
    bytesize: Literal[5, 6, 7, 8] = 8
    """Data bits."""
    parity: Literal["N", "E", "O", "M", "S"] = "N"
    """None, even, odd, mark or space."""
    stopbits: Literal[1, 2] = 1
    """Stop bits."""
    dtr: bool = True
    """Level of the control line DTR, which resets or wakes some boards."""
    rts: bool = True
    """Level of the control line RTS."""
    timeout_s: float = Field(default=1.0, ge=0, le=3600)
    """Longest wait of a read or a write."""
    name: str = Field(default="SerialPort", pattern=r"^[A-Za-z][A-Za-z0-9_]*$")
    """The resource's name."""


@dataclass(frozen=True)
class SerialFraming:
    """The serial line format and its control lines; the attributes have pyserial's names."""

    baudrate: int
    bytesize: int
    parity: str
    stopbits: int
    dtr: bool
    rts: bool

    def bytes_per_s(self) -> float:
        """Return the throughput in bytes per second."""
        return self.baudrate / (1 + self.bytesize + (self.parity != "N") + self.stopbits)


def _framing_key(key: str, value: ValueInfo, description: str) -> tuple[Callable[..., Any], Callable[..., None]]:
    """Return the getter and the setter of a configuration key that is a part of the framing."""

    @config(key, value, description=description)
    def get(self: SerialPort) -> Any:
        return getattr(self._framing, key)

    @config_setter(key)
    def put(self: SerialPort, part: Any) -> None:
        self._frame(replace(self._framing, **{key: part}))

    return get, put


class SerialPort(Line):
    """A serial port; get_status: the number of bytes to read.

    Args:
        url: see Settings.port.
        framing: the initial line format.
        timeout_s: longest wait of a read or a write.
    """

    def __init__(self, url: str, framing: SerialFraming, clock: Clock, timeout_s: float) -> None:
        self._url = url
        self._framing = framing
        super().__init__(ReopeningPort(self._open_port, clock, url), clock, timeout_s)

    def send(self, data: memoryview) -> int:
        """Send only the bytes of one poll interval, so that a stop need not wait for a full buffer."""
        return self.port.write(bytes(data[: max(int(self._framing.bytes_per_s() * LOOK_S), 1)]))

    baudrate, set_baudrate = _framing_key("baudrate", _BAUDRATE, "Bits per second.")
    bytesize, set_bytesize = _framing_key("bytesize", _BYTESIZE, "Data bits.")
    parity, set_parity = _framing_key("parity", _PARITY, "None, even, odd, mark or space.")
    stopbits, set_stopbits = _framing_key("stopbits", _STOPBITS, "Stop bits.")
    dtr, set_dtr = _framing_key("dtr", _LEVEL, "Control line DTR.")
    rts, set_rts = _framing_key("rts", _LEVEL, "Control line RTS.")

    def _open_port(self) -> BytePort:
        return open_serial(self._url, **vars(self._framing))

    def _frame(self, framing: SerialFraming) -> None:
        """Change the line format, now and after each reopening.

        Raises:
            ArgumentError: the port does not support it; the format stays unchanged.
        """
        before = self._framing

        def change(port: Any) -> None:
            try:
                _apply(framing, port)
            except _UNSUPPORTED as error:
                with suppress(*_UNSUPPORTED):  # pyserial sets the line again that it could not set
                    _apply(before, port)
                raise ArgumentError(f"the port {self._url} cannot do {framing}: {error}") from error

        self.port.use(change)
        self._framing = framing


def _apply(framing: SerialFraming, port: Any) -> None:
    for key, value in vars(framing).items():
        if getattr(port, key, value) != value:  # a network connection has none of these attributes
            setattr(port, key, value)


def connect(context: PluginContext) -> PortPlugin:
    """Open the port; an absent port is opened when it appears.

    Raises:
        PluginError: the settings are invalid.

    Thread: the robot's; a network connection may block for seconds.
    """
    settings: Settings = context.settings
    framing = SerialFraming(**{key: getattr(settings, key) for key in SerialFraming.__dataclass_fields__})
    resource = SerialPort(settings.port, framing, context.clock, settings.timeout_s)
    resource.port.open()
    return PortPlugin(settings.name, resource)
