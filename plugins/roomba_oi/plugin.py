"""The roomba_oi plugin: later Roombas and the Create 2 over their Open Interface."""

# ruff: noqa: N816  # create_Base and its like are what the plugin API calls

from __future__ import annotations

from typing import Final, Literal

from eal_actors.plugin import Field, PluginContext, PluginSettingsModel, WheelCalibration

from ..mote_roomba import protocol as sci
from ..mote_roomba.base import Base
from ..mote_roomba.bodies import Body
from ..mote_roomba.link import SerialLink, open_port
from ..mote_roomba.plugin import RoombaPlugin, creator, destroy, disconnect, wake
from ..mote_roomba.power import Power
from ..mote_roomba.protocol import Mode
from ..mote_roomba.sensors import Battery, Bump, Cliff, Odometry, Wall
from .emulator import OiEmulator
from .panel import Buttons, Leds, Song, WheelDrop
from .protocol import WHEELBASE_M
from .roomba import OiRoomba

__all__ = ["Settings", "connect", "disconnect"]

_SIMULATED_WHEELBASE_M: Final = sci.WHEELBASE_M
"""The simulated Roomba is a 4xx, whatever speaks to it."""


class Settings(PluginSettingsModel):
    """What the fleet file may set."""

    port: str = Field(min_length=1)
    """The serial port: a device path, a URL that pyserial knows, such as socket://host:port, or sim://world."""
    baudrate: Literal[115200, 19200] = 115200
    """Baud rate; the Roomba uses 19200 if a button was held, or a pin was pulled low, while it was switched on."""
    mode: Literal["safe", "full"] = "safe"
    """In safe mode the Roomba stops itself at cliffs and when a wheel drops; in full mode the driver alone does."""
    poll_hz: float = Field(default=20.0, ge=5, le=50)
    """Readings of the sensors a second, of the 66 that the Roomba streams."""
    calibration: WheelCalibration = WheelCalibration()
    """What the base knows of its wheels and makes up for, as `eal calibrate` finds it out."""


def connect(context: PluginContext) -> RoombaPlugin:
    """Open the port and wake the Roomba; where it is absent or silent, it is not ready, and tried again.

    Raises:
        PluginError: the port can never be opened.

    Thread: the robot's; waits until the first reading has come, so that the resources can answer from their start.
    """
    settings: Settings = context.settings
    link = SerialLink(open_port(context, settings.port, settings.baudrate, "roomba", _emulator))
    wheelbase_m = _SIMULATED_WHEELBASE_M if settings.port.startswith("sim:") else WHEELBASE_M
    roomba = OiRoomba(link, context.clock, Mode(settings.mode), settings.poll_hz, context.robot, wheelbase_m)
    roomba.calibration = settings.calibration
    return wake(RoombaPlugin(roomba))


def _emulator(body: Body) -> OiEmulator:
    """Return the emulator for a simulated body, whose time goes in ticks that may be longer than the pauses."""
    return OiEmulator(body, mode_pause_s=0.0, wheelbase_m=_SIMULATED_WHEELBASE_M)


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
