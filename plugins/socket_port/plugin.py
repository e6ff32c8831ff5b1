"""The socket_port plugin: a TCP or UDP connection as a communication resource (Source: thesis §4.2.1, §4.4.3)."""

from __future__ import annotations

from typing import Any, Literal

from eal_actors.plugin import (
    Field,
    PluginContext,
    PluginError,
    PluginSettingsModel,
    ReopeningPort,
    UdpPort,
    open_tcp,
)

from ..serial_port.line import Line, PortPlugin, disconnect
from .datagrams import Datagrams

__all__ = ["Settings", "connect", "disconnect"]


class Settings(PluginSettingsModel):
    """The plugin's settings in the fleet file."""

    host: str = Field(min_length=1)
    """Name or address of the peer."""
    port: int = Field(ge=1, le=65535)
    """Its port."""
    protocol: Literal["tcp", "udp"] = "tcp"
    """A byte stream, or datagrams."""
    local_port: int = Field(default=0, ge=0, le=65535)
    """For udp: the local port; 0 for any."""
    connect_timeout_s: float = Field(default=5.0, ge=0.05, le=60)
    """For tcp: timeout of a connection attempt, in real seconds; it is repeated."""
    timeout_s: float = Field(default=1.0, ge=0, le=3600)
    """Longest wait of a read or a write."""
    name: str = Field(default="SocketPort", pattern=r"^[A-Za-z][A-Za-z0-9_]*$")
    """The resource's name."""


class TcpStream(Line):
    """Sends and receives bytes over TCP; get_status: the number of bytes to read."""

    def send(self, data: memoryview) -> int:
        """Send as many bytes as possible without waiting; return their number."""

        def send_some(port: Any) -> int:
            sent: int = port.write_some(data)
            return sent

        return self.port.use(send_some)


def connect(context: PluginContext) -> PortPlugin:
    """Connect; attempts are repeated while the peer is absent.

    Raises:
        PluginError: the settings contradict each other.

    Thread: the robot's; blocks for the name lookup and at most `connect_timeout_s`.
    """
    settings: Settings = context.settings
    host, number = settings.host, settings.port
    name = f"{settings.protocol}://{host}:{number}"
    port: ReopeningPort
    resource: Line
    if settings.protocol == "udp":
        port = ReopeningPort(lambda: UdpPort(host, number, settings.local_port), context.clock, name)
        resource = Datagrams(port, context.clock, settings.timeout_s)
    elif settings.local_port:
        raise PluginError(f"local_port needs protocol: udp, but {name} is tcp")
    else:
        port = ReopeningPort(lambda: open_tcp(host, number, settings.connect_timeout_s), context.clock, name)
        resource = TcpStream(port, context.clock, settings.timeout_s)
    port.open()
    return PortPlugin(settings.name, resource)
