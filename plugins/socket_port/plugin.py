"""The socket_port plugin: a TCP or UDP connection as a communication resource (Source: thesis §4.2.1, §4.4.3)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from eal_actors.plugin import (
    EALPlugin,
    Field,
    PluginContext,
    PluginError,
    PluginSettingsModel,
    ReopeningPort,
    open_tcp,
)

from ..serial_port.line import Line
from .datagrams import Datagrams, UdpPort


class Settings(PluginSettingsModel):
    """What the fleet file may set."""

    host: str = Field(min_length=1)
    """Name or address of the other end."""
    port: int = Field(ge=1, le=65535)
    """Its port."""
    protocol: Literal["tcp", "udp"] = "tcp"
    """A stream of bytes, or datagrams."""
    local_port: int = Field(default=0, ge=0, le=65535)
    """For udp: the port at this end; 0 for any."""
    connect_timeout_s: float = Field(default=5.0, ge=0.05, le=60)
    """For tcp: real seconds in which the other end must answer, or it is tried again."""
    timeout_s: float = Field(default=1.0, ge=0, le=3600)
    """How long a read or a write waits at most."""
    name: str = Field(default="SocketPort", pattern=r"^[A-Za-z][A-Za-z0-9_]*$")
    """The resource's name."""


class Stream(Line):
    """Bytes there and back over TCP, in order; get_status answers how many wait to be read."""

    def send(self, data: memoryview) -> int:
        """Send what goes out at once."""

        def send_some(port: Any) -> int:
            sent: int = port.write_some(data)
            return sent

        return self._port.use(send_some)


class SocketPlugin(EALPlugin):
    """Holds the one connection."""

    def __init__(self, name: str, port: ReopeningPort, resource: Line) -> None:
        super().__init__(name)
        self.port = port
        self.resource = resource


def connect(context: PluginContext) -> SocketPlugin:
    """Connect; while the other end is absent, it is tried again and again.

    Raises:
        PluginError: the settings contradict each other.

    Thread: the robot's; takes up to `connect_timeout_s`, and as long as it takes to look up the name.
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
        raise PluginError(f"local_port is for udp, and {name} is tcp")
    else:
        port = ReopeningPort(lambda: open_tcp(host, number, settings.connect_timeout_s), context.clock, name)
        resource = Stream(port, context.clock, settings.timeout_s)
    port.open()
    return SocketPlugin(settings.name, port, resource)


def disconnect(plugin: SocketPlugin) -> None:
    """Hang up."""
    plugin.port.close()


def __getattr__(name: str) -> Callable[..., Any]:
    """Return `create_<name>` and `destroy_<name>`, whatever name the settings give the resource."""
    if name.startswith("create_"):
        return _create
    if name.startswith("destroy_"):
        return _destroy
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _create(context: PluginContext) -> Line:
    """Return the resource, which the plugin holds with its connection."""
    resource: Line = context.plugin.resource
    return resource


def _destroy(resource: Line) -> None:
    """Let go of what `_create` took: nothing, the connection is the plugin's."""
