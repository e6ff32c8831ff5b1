"""The evbot3 plugin: two wheels and a turret over a wireless network (Source: thesis §6.1.2)."""

# ruff: noqa: N802, N816  # create_Base and its like are what the plugin API calls

from __future__ import annotations

from typing import Final
from urllib.parse import urlsplit

from pydantic import field_validator

from eal_actors.plugin import (
    BytePort,
    Drivetrain,
    Field,
    PluginContext,
    Resource,
    open_tcp,
)

from ..evbot2.base import Base
from ..evbot2.connecting import EvBotPlugin, TalkSettings, come_up, way_to
from ..evbot2.messages import Channel
from ..evbot2.odometry import Odometry
from .datagrams import UdpPort
from .emulator import WHEELS, in_the_world
from .protocol import MODEL, HostCodec
from .sensors import Battery, Bump
from .turret import Turret

DRIVETRAIN: Final = Drivetrain("evbot3", WHEELS.track_m, 0.35, WHEELS.max_speed_m_s, 90.0, 150.0)
"""The EvBot III."""

_CONNECT_TIMEOUT_S: Final = 2.0


class Settings(TalkSettings):
    """What the fleet file may set."""

    address: str = Field(min_length=1)
    """Where the base listens: udp://host:port, tcp://host:port, or sim://world/<robot>."""

    @field_validator("address")
    @classmethod
    def _check_address(cls, address: str) -> str:
        if not address.startswith("sim:"):
            _endpoint(address)
        return address


def _endpoint(address: str) -> tuple[str, str, int]:
    """Return scheme, host and port of an address.

    Raises:
        ValueError: it is none.
    """
    parts = urlsplit(address)
    is_plain = not (parts.path or parts.query or parts.fragment or parts.username)
    if parts.scheme not in ("udp", "tcp") or not parts.hostname or not parts.port or not is_plain:
        raise ValueError(f"{address!r} is no udp://host:port, tcp://host:port or sim://world/<robot>")
    return parts.scheme, parts.hostname, parts.port


def _open(address: str) -> BytePort:
    scheme, host, port = _endpoint(address)
    return UdpPort(host, port) if scheme == "udp" else open_tcp(host, port, _CONNECT_TIMEOUT_S)


def connect(context: PluginContext) -> EvBotPlugin:
    """Open the way to the base and greet it; one that is away is not ready, and greeted when it comes.

    Raises:
        PluginError: no EvBot III can be behind such an address.

    Thread: the robot's; see way_to and come_up.
    """
    settings: Settings = context.settings
    way = way_to(context, settings.address, DRIVETRAIN.name, in_the_world, lambda: _open(settings.address))
    channels = (Channel.WHEELS, Channel.TURRET)
    talk, odometer = come_up(context, way, HostCodec(), model=MODEL, channels=channels, track_m=DRIVETRAIN.track_m)
    return EvBotPlugin(talk, odometer, "Base", "Odometry", "Turret", "Bump", "Battery")


def disconnect(plugin: EvBotPlugin) -> None:
    """Close the way to the base, which has been stopped before."""
    plugin.talk.close()


def create_Base(context: PluginContext) -> Base:
    """Make the base."""
    return Base(context.plugin.talk, context.plugin.odometer, DRIVETRAIN)


def create_Odometry(context: PluginContext) -> Odometry:
    """Make the odometry."""
    return Odometry(context.plugin.talk, context.plugin.odometer)


def create_Turret(context: PluginContext) -> Turret:
    """Make the turret."""
    return Turret(context.plugin.talk)


def create_Bump(context: PluginContext) -> Bump:
    """Make the bumpers."""
    return Bump(context.plugin.talk)


def create_Battery(context: PluginContext) -> Battery:
    """Make the battery."""
    return Battery(context.plugin.talk)


def _destroy(resource: Resource) -> None:
    """Let go of what `create_...` took: nothing, the talk is the plugin's."""


destroy_Base = destroy_Odometry = destroy_Turret = destroy_Bump = destroy_Battery = _destroy
