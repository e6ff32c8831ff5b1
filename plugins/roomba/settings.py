"""The settings of the plugin."""

from __future__ import annotations

from typing import Final, Literal, Self

from pydantic import model_validator

from eal_actors.plugin import Field, PluginSettingsModel, WheelCalibration

from . import oi, sci
from .tinyos import Header, TinyosFraming

BAUD_RATES: Final = {"sci": (sci.BAUD_RATE, 19200), "oi": (oi.BAUD_RATE,)}
"""The baud rates of each protocol; the first one is the default. At 19200, a frame of the OI's stream would take longer
than the 15 ms to the next one: readings would be older and older."""
SIMULATED: Final = "sim:"
"""A port that begins so is one of the simulation."""


class MoteSettings(PluginSettingsModel):
    """The base mote at the serial port, where `link` is `mote`."""

    baudrate: Literal[9600, 19200, 38400, 57600, 115200] = 115200
    """Baud rate of the base mote: 115200 for a Telos or Tmote, 57600 for a Mica2 or MicaZ."""
    header: Header = Field(default=Header.TINYOS_2, strict=False)
    """Form of the packets: `tinyos2`, or `tinyos1` with its other protocol bytes."""
    ack_byte: int | None = Field(default=None, ge=0, le=255)
    """Protocol byte of an acknowledgement; that of the form if left out."""
    reliable_byte: int | None = Field(default=None, ge=0, le=255)
    """Protocol byte of a packet with acknowledgement; that of the form if left out."""
    plain_byte: int | None = Field(default=None, ge=0, le=255)
    """Protocol byte of a packet without acknowledgement; that of the form if left out."""
    am_type: int = Field(default=0x89, ge=0, le=255)
    """Active message type of the packets that carry the Roomba's bytes."""
    destination: int = Field(default=0xFFFF, ge=0, le=0xFFFF)
    """Address of the mote on the robot; 65535 is broadcast."""
    group: int = Field(default=0x22, ge=0, le=255)
    """Group of both motes."""
    payload_bytes: int = Field(default=28, ge=1, le=114)
    """Maximum payload of a packet."""
    tries: int = Field(default=5, ge=1, le=20)
    """Number of tries of a packet without an acknowledgement before the link fails."""

    def framing(self) -> TinyosFraming:
        """Return the form of the packets."""
        return TinyosFraming(**self.model_dump(exclude={"baudrate", "tries"}))


class Settings(PluginSettingsModel):
    """The settings of a Roomba."""

    protocol: Literal["sci", "oi"]
    """The Roomba's protocol: `sci`, the Serial Command Interface, for the 4xx series; `oi`, the Open Interface, for the
    Create 2 and Roombas from the 500 series on."""
    link: Literal["cable", "mote", "sim"] = "cable"
    """The way to the Roomba: its cable at the serial port, a pair of motes, or a simulated world."""
    port: str | None = Field(default=None, min_length=1)
    """The serial port: a device path, a URL of pyserial such as socket://host:port, or a simulated port such as
    sim://world/NAME. Only `link: sim` may leave it out, for the robot of the same name in the simulated world."""
    baudrate: Literal[115200, 57600, 19200] | None = None
    """Baud rate of the Roomba: 115200 for `oi`; 57600 for `sci`, or 19200, which it uses if a button was held while it
    was switched on."""
    dtr: bool = True
    """Level of the control line DTR, which wakes the Roomba where it is wired to device detect (BRC)."""
    rts: bool = True
    """Level of the control line RTS, likewise."""
    mode: Literal["safe", "full"] = "safe"
    """In safe mode the Roomba stops itself at cliffs and when a wheel drops; in full mode only the driver stops it."""
    poll_hz: float = Field(default=20.0, ge=5, le=50)
    """Readings of the sensors a second."""
    calibration: WheelCalibration = WheelCalibration()
    """The measured properties of the wheels, as `eal calibrate` writes them."""
    mote: MoteSettings | None = None
    """The motes; only where `link` is `mote`."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        rates = BAUD_RATES[self.protocol]
        if self.baudrate is not None and self.baudrate not in rates:
            takes = " or ".join(map(str, rates))
            raise ValueError(f"baudrate is {takes} with protocol: {self.protocol}, not {self.baudrate}")
        if self.link == "mote" and self.protocol == "oi":
            raise ValueError("link: mote needs protocol: sci")
        if self.mote is not None and self.link != "mote":
            raise ValueError("the settings under mote need link: mote")
        if self.port is None and self.link != "sim":
            raise ValueError(f"port is missing; link: {self.link} needs one")
        if self.link == "sim" and self.port is not None and not self.port.startswith(SIMULATED):
            raise ValueError(f"link: sim needs a simulated port, such as sim://world/NAME, not {self.port}")
        return self

    @property
    def url(self) -> str:
        """The port as a device path or a URL."""
        return self.port or f"{SIMULATED}//world"

    @property
    def is_simulated(self) -> bool:
        """Whether the port is one of the simulation."""
        return self.url.startswith(SIMULATED)

    @property
    def line_baudrate(self) -> int:
        """The baud rate of the serial port."""
        if self.link == "mote":
            return self.motes().baudrate
        return self.baudrate or BAUD_RATES[self.protocol][0]

    def motes(self) -> MoteSettings:
        """Return the settings of the motes."""
        return self.mote or MoteSettings()
