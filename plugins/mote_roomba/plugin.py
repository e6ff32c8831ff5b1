"""The mote_roomba plugin: a Roomba over its Serial Command Interface (Source: thesis §6.1.3)."""

# ruff: noqa: N816  # create_Base and its like are what the plugin API calls

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from eal_actors.plugin import (
    EALPlugin,
    Field,
    PluginContext,
    PluginError,
    PluginSettingsModel,
    Resource,
    WheelCalibration,
)

from .base import Base
from .bodies import Body
from .driver import RoombaDriver
from .emulator import RoombaEmulator
from .link import Link, SerialLink, open_port
from .mote_link import MoteLink
from .motes import MotePair
from .panel import Leds, Song
from .power import Power
from .protocol import Mode
from .roomba import Roomba
from .sensors import Battery, Bump, Buttons, Cliff, Odometry, Wall, WheelDrop
from .tinyos import Framing, Header


class MoteSettings(PluginSettingsModel):
    """How the base mote at the serial port is spoken to, where `link` is `mote`."""

    baudrate: Literal[9600, 19200, 38400, 57600, 115200] = 115200
    """Baud rate of the base mote: 115200 for a Telos or Tmote, 57600 for a Mica2 or MicaZ."""
    header: Header = Field(default=Header.TINYOS_2, strict=False)
    """Form of the packets: `tinyos2`, or `tinyos1` with its other protocol bytes."""
    ack_byte: int | None = Field(default=None, ge=0, le=255)
    """Protocol byte of an acknowledgement; that of the form if left out."""
    reliable_byte: int | None = Field(default=None, ge=0, le=255)
    """Protocol byte of a packet that wants an acknowledgement; that of the form if left out."""
    plain_byte: int | None = Field(default=None, ge=0, le=255)
    """Protocol byte of a packet that wants none; that of the form if left out."""
    am_type: int = Field(default=0x89, ge=0, le=255)
    """Active message type of the packets that carry the Roomba's bytes."""
    destination: int = Field(default=0xFFFF, ge=0, le=0xFFFF)
    """Address of the mote on the robot; 65535 is everybody."""
    group: int = Field(default=0x22, ge=0, le=255)
    """Group of both motes."""
    payload_bytes: int = Field(default=28, ge=1, le=114)
    """What one packet holds at most."""
    tries: int = Field(default=5, ge=1, le=20)
    """How often a packet is sent in all before the link gives up for want of an acknowledgement."""

    def framing(self) -> Framing:
        """Return the form of the packets."""
        return Framing(
            header=self.header,
            ack_byte=self.ack_byte,
            reliable_byte=self.reliable_byte,
            plain_byte=self.plain_byte,
            am_type=self.am_type,
            destination=self.destination,
            group=self.group,
            payload_bytes=self.payload_bytes,
        )


class Settings(PluginSettingsModel):
    """What the fleet file may set."""

    port: str = Field(min_length=1)
    """The serial port: a device path, a URL that pyserial knows, such as socket://host:port, or sim://world."""
    link: Literal["serial", "mote"] = "serial"
    """What is at the port: the Roomba itself, or a mote whose radio reaches the mote on the robot."""
    baudrate: Literal[57600, 19200] = 57600
    """Baud rate of the Roomba; it uses 19200 if its power button was held while it was switched on."""
    mode: Literal["safe", "full"] = "safe"
    """In safe mode the Roomba stops itself at cliffs and when a wheel drops; in full mode the driver alone does."""
    poll_hz: float = Field(default=20.0, ge=5, le=50)
    """Readings of the sensors a second."""
    calibration: WheelCalibration = WheelCalibration()
    """What the base knows of its wheels and makes up for, as `eal calibrate` finds it out."""
    mote: MoteSettings | None = None
    """How the motes are spoken to; only where `link` is `mote`."""

    def motes(self) -> MoteSettings:
        """Return how the motes are spoken to."""
        return self.mote or MoteSettings()


class RoombaPlugin(EALPlugin):
    """A Roomba at the other end of a link."""

    def __init__(self, roomba: RoombaDriver) -> None:
        super().__init__(
            "Base", "Bump", "Cliff", "WheelDrop", "Wall", "Battery", "Odometry", "Buttons", "Leds", "Song", "Power"
        )
        self.roomba = roomba


def connect(context: PluginContext) -> RoombaPlugin:
    """Open the port and wake the Roomba; where it is absent or silent, it is not ready, and tried again.

    Raises:
        PluginError: the settings contradict one another, or the port can never be opened.

    Thread: the robot's; waits until the first reading has come, so that the resources can answer from their start.
    """
    settings: Settings = context.settings
    if settings.mote is not None and settings.link != "mote":
        raise PluginError(f"robot {context.robot!r}: the settings under mote are of no use without link: mote")
    roomba = Roomba(_link(context, settings), context.clock, Mode(settings.mode), settings.poll_hz, context.robot)
    roomba.calibration = settings.calibration
    return wake(RoombaPlugin(roomba))


def wake(plugin: RoombaPlugin) -> RoombaPlugin:
    """Wake the Roomba of a plugin that connects, and return the plugin."""
    roomba = plugin.roomba
    try:
        for delay_s in roomba.wake():
            roomba.clock.sleep(delay_s)
    except BaseException:
        roomba.close()
        raise
    return plugin


def disconnect(plugin: RoombaPlugin) -> None:
    """Leave the Roomba to itself and close the port; the base has stopped the Roomba before."""
    roomba = plugin.roomba
    try:
        for delay_s in roomba.farewell():
            roomba.clock.sleep(delay_s)
    finally:
        roomba.close()


def _link(context: PluginContext, settings: Settings) -> Link:
    if settings.link == "serial":
        return SerialLink(open_port(context, settings.port, settings.baudrate, "roomba", _emulator))
    mote = settings.motes()

    def motes(body: Body) -> MotePair:
        return MotePair(_emulator(body), mote.framing())

    port = open_port(context, settings.port, mote.baudrate, "roomba", motes)
    return MoteLink(port, context.clock, mote.framing(), mote.tries)


def _emulator(body: Body) -> RoombaEmulator:
    """Return the emulator for a simulated body, whose time goes in ticks that may be longer than the pauses."""
    return RoombaEmulator(body, mode_pause_s=0.0)


def creator(kind: Callable[[RoombaDriver], Resource]) -> Callable[[PluginContext], Resource]:
    """Return the function that makes a resource of a kind."""

    def create(context: PluginContext) -> Resource:
        """Make the resource."""
        return kind(context.plugin.roomba)

    return create


def destroy(resource: Resource) -> None:
    """Let go of what `create_...` took: nothing, the Roomba is the plugin's."""


create_Base, destroy_Base = creator(Base), destroy
create_Bump, destroy_Bump = creator(Bump), destroy
create_Cliff, destroy_Cliff = creator(Cliff), destroy
create_WheelDrop, destroy_WheelDrop = creator(WheelDrop), destroy
create_Wall, destroy_Wall = creator(Wall), destroy
create_Battery, destroy_Battery = creator(Battery), destroy
create_Odometry, destroy_Odometry = creator(Odometry), destroy
create_Buttons, destroy_Buttons = creator(Buttons), destroy
create_Leds, destroy_Leds = creator(Leds), destroy
create_Song, destroy_Song = creator(Song), destroy
create_Power, destroy_Power = creator(Power), destroy
