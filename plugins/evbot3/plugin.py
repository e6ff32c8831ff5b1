"""The evbot3 plugin: two wheels and a turret over a wireless network (Source: thesis §6.1.2)."""

from __future__ import annotations

from typing import Final
from urllib.parse import urlsplit

from pydantic import field_validator

from eal_actors.plugin import BytePort, Drivetrain, Field, OdometryNoise, PluginContext, UdpPort, open_tcp

from ..evbot2.connecting import EvBotPlugin, SessionSettings, disconnect, open_base_port, start_session
from ..evbot2.messages import OrderChannel
from ..evbot2.odometry import Odometer
from ..evbot2.session import BaseSession
from .emulator import WHEELS, simulated_evbot3
from .protocol import MODEL, host_codec
from .sensors import Battery, Bump, BumperBase
from .turret import Turret

__all__ = ["Settings", "connect", "disconnect"]

DRIVETRAIN: Final = Drivetrain(
    "evbot3", WHEELS.track_m, 0.35, WHEELS.max_speed_m_s, 90.0, 150.0, WHEELS.acceleration_m_s2
)
"""The EvBot III."""

NOISE: Final = OdometryNoise(DRIVETRAIN.track_m, 0.001, 0.003, scale_share=0.005, drift_rad_m=0.015, turn_share=0.015)
"""The errors of its wheels before a calibration."""

_CONNECT_TIMEOUT_S: Final = 2.0


class Settings(SessionSettings):
    """The plugin's settings in the fleet file."""

    address: str = Field(min_length=1)
    """The address of the base: udp://host:port, tcp://host:port, or sim://world/<robot>."""

    @field_validator("address")
    @classmethod
    def _check_address(cls, address: str) -> str:
        if not address.startswith("sim:"):
            _endpoint(address)
        return address


def _endpoint(address: str) -> tuple[str, str, int]:
    """Return scheme, host and port of an address.

    Raises:
        ValueError: it is invalid.
    """
    parts = urlsplit(address)
    is_plain = not (parts.path or parts.query or parts.fragment or parts.username)
    if parts.scheme not in ("udp", "tcp") or not parts.hostname or not parts.port or not is_plain:
        raise ValueError(f"{address!r} is not udp://host:port, tcp://host:port or sim://world/<robot>")
    return parts.scheme, parts.hostname, parts.port


def _open(address: str) -> BytePort:
    scheme, host, port = _endpoint(address)
    return UdpPort(host, port) if scheme == "udp" else open_tcp(host, port, _CONNECT_TIMEOUT_S)


def connect(context: PluginContext) -> EvBotPlugin:
    """Open the port and greet the base; an absent base is not ready, and greeted when it appears.

    Raises:
        PluginError: the address is invalid.

    Thread: the robot's; see open_base_port and start_session.
    """
    settings: Settings = context.settings
    address = settings.address
    port = open_base_port(context, address, DRIVETRAIN.name, simulated_evbot3, lambda: _open(address))
    channels = (OrderChannel.WHEELS, OrderChannel.TURRET)
    codec = host_codec()
    session, odometer = start_session(context, port, codec, model=MODEL, channels=channels, noise=NOISE)
    return plugin_of(context, session, odometer)


def plugin_of(context: PluginContext, session: BaseSession, odometer: Odometer) -> EvBotPlugin:
    """Return the plugin of a session."""
    return EvBotPlugin(
        context,
        session,
        odometer,
        lambda: BumperBase(session, odometer, DRIVETRAIN, context),
        Turret=lambda: Turret(session),
        Bump=lambda: Bump(session),
        Battery=lambda: Battery(session),
    )
