"""The evbot2 plugin: a tracked base over a serial line (Source: thesis §6.1.1)."""

# ruff: noqa: N802, N816  # create_Base and its like are what the plugin API calls

from __future__ import annotations

from typing import Final, Literal

from eal_actors.plugin import (
    Drivetrain,
    Field,
    PluginContext,
    Resource,
    open_serial,
)

from .base import Base
from .connecting import EvBotPlugin, TalkSettings, come_up, way_to
from .emulator import TRACKS, in_the_world
from .messages import Channel
from .odometry import Odometry
from .protocol import BAUD_RATE, MODEL, HostCodec

DRIVETRAIN: Final = Drivetrain("evbot2", TRACKS.track_m, 0.25, TRACKS.max_speed_m_s, 60.0, 120.0)
"""The EvBot II."""


class Settings(TalkSettings):
    """What the fleet file may set."""

    port: str = Field(min_length=1)
    """The serial port: a device path, a URL that pyserial knows, such as socket://host:port, or sim://world/<robot>."""
    baudrate: Literal[9600, 19200, 38400, 57600, 115200] = BAUD_RATE
    """Baud rate of a device path."""


def connect(context: PluginContext) -> EvBotPlugin:
    """Open the port and greet the base; one that is away is not ready, and greeted when it comes.

    Raises:
        PluginError: no EvBot II can be behind such a port.

    Thread: the robot's; see way_to and come_up.
    """
    settings: Settings = context.settings
    way = way_to(
        context,
        settings.port,
        DRIVETRAIN.name,
        in_the_world,
        lambda: open_serial(settings.port, baudrate=settings.baudrate),
    )
    talk, odometer = come_up(
        context, way, HostCodec(), model=MODEL, channels=(Channel.WHEELS,), track_m=DRIVETRAIN.track_m
    )
    return EvBotPlugin(talk, odometer, "Base", "Odometry")


def disconnect(plugin: EvBotPlugin) -> None:
    """Close the port; the base has been stopped before."""
    plugin.talk.close()


def create_Base(context: PluginContext) -> Base:
    """Make the base."""
    return Base(context.plugin.talk, context.plugin.odometer, DRIVETRAIN)


def create_Odometry(context: PluginContext) -> Odometry:
    """Make the odometry."""
    return Odometry(context.plugin.talk, context.plugin.odometer)


def _destroy(resource: Resource) -> None:
    """Let go of what `create_...` took: nothing, the talk is the plugin's."""


destroy_Base, destroy_Odometry = _destroy, _destroy
