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
    UnavailableError,
)

from .base import Base
from .link import SerialLink, open_port
from .panel import Leds, Song
from .protocol import Mode
from .roomba import Roomba
from .sensors import Battery, Bump, Buttons, Cliff, Odometry, Wall, WheelDrop


class Settings(PluginSettingsModel):
    """What the fleet file may set."""

    port: str = Field(min_length=1)
    """The serial port: a device path, a URL that pyserial knows, such as socket://host:port, or sim://world."""
    link: Literal["serial"] = "serial"
    """What carries the bytes to the Roomba."""
    baudrate: Literal[57600, 19200] = 57600
    """Baud rate; the Roomba uses 19200 if its power button was held while it was switched on."""
    mode: Literal["safe", "full"] = "safe"
    """In safe mode the Roomba stops itself at cliffs and when a wheel drops; in full mode the driver alone does."""
    poll_hz: float = Field(default=20.0, ge=5, le=50)
    """Readings of the sensors a second."""


class RoombaPlugin(EALPlugin):
    """A Roomba at the other end of a link."""

    def __init__(self, roomba: Roomba) -> None:
        super().__init__("Base", "Bump", "Cliff", "WheelDrop", "Wall", "Battery", "Odometry", "Buttons", "Leds", "Song")
        self.roomba = roomba


def connect(context: PluginContext) -> RoombaPlugin:
    """Open the port and wake the Roomba.

    Raises:
        PluginError: the port cannot be opened, or nothing answers on it.

    Thread: the robot's; waits until the first reading has come, so that the resources can answer from their start.
    """
    settings: Settings = context.settings
    link = SerialLink(open_port(context, settings), settings.port)
    roomba = Roomba(link, context.clock, Mode(settings.mode), settings.poll_hz, context.robot)
    try:
        for delay_s in roomba.wake():
            context.clock.sleep(delay_s)
    except BaseException as error:
        link.close()
        if isinstance(error, UnavailableError):
            raise PluginError(f"robot {context.robot!r}: {error.message}") from error
        raise
    return RoombaPlugin(roomba)


def disconnect(plugin: RoombaPlugin) -> None:
    """Close the port; the base has stopped the Roomba before."""
    plugin.roomba.close()


def _creator(kind: Callable[[Roomba], Resource]) -> Callable[[PluginContext], Resource]:
    def create(context: PluginContext) -> Resource:
        """Make the resource."""
        return kind(context.plugin.roomba)

    return create


def _destroy(resource: Resource) -> None:
    """Let go of what `create_...` took: nothing, the Roomba is the plugin's."""


create_Base, destroy_Base = _creator(Base), _destroy
create_Bump, destroy_Bump = _creator(Bump), _destroy
create_Cliff, destroy_Cliff = _creator(Cliff), _destroy
create_WheelDrop, destroy_WheelDrop = _creator(WheelDrop), _destroy
create_Wall, destroy_Wall = _creator(Wall), _destroy
create_Battery, destroy_Battery = _creator(Battery), _destroy
create_Odometry, destroy_Odometry = _creator(Odometry), _destroy
create_Buttons, destroy_Buttons = _creator(Buttons), _destroy
create_Leds, destroy_Leds = _creator(Leds), _destroy
create_Song, destroy_Song = _creator(Song), _destroy
