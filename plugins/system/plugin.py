"""The system plugin: gauges of the computer that runs the robot's process."""

# ruff: noqa: N816  # the plugin API requires names such as create_Cpu

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal, get_args

from eal_actors.plugin import EALPlugin, Field, PluginContext, PluginSettingsModel, Resource

from .gauges import Cpu, Disk, Memory, Network, Temperature, Uptime, temperatures_c

Gauge = Literal["Cpu", "Memory", "Disk", "Temperature", "Network", "Uptime"]

_GAUGES: Final[tuple[str, ...]] = get_args(Gauge)


class Settings(PluginSettingsModel):
    """The plugin's settings in the fleet file."""

    resources: tuple[Gauge, ...] | None = Field(default=None, min_length=1, strict=False)
    """The resources to provide; default: all, but `Temperature` only if the computer has a sensor."""
    disk: str = Field(default="/", min_length=1)
    """A path on the file system of `Disk`; it must be local, because a remote one may block."""
    interface: str | None = Field(default=None, min_length=1)
    """The network interface, such as wlan0; default: the sum of all but the loopback."""
    period_s: float = Field(default=1.0, ge=0.1, le=3600)
    """Poll interval of `Cpu`, `Temperature` and `Network`."""


def connect(context: PluginContext) -> EALPlugin:
    """Name the resources."""
    settings: Settings = context.settings
    found = [gauge for gauge in _GAUGES if gauge != "Temperature" or temperatures_c()]
    return EALPlugin(*(settings.resources or found))


def disconnect(plugin: EALPlugin) -> None:
    """Do nothing."""


def _creator(make: Callable[[PluginContext], Resource]) -> Callable[[PluginContext], Resource]:
    def create(context: PluginContext) -> Resource:
        """Create the resource."""
        return make(context)

    return create


def _destroy(resource: Resource) -> None:
    """Do nothing."""


create_Cpu, destroy_Cpu = _creator(lambda context: Cpu(context.settings.period_s)), _destroy
create_Memory, destroy_Memory = _creator(lambda _: Memory()), _destroy
create_Disk, destroy_Disk = _creator(lambda context: Disk(context.settings.disk)), _destroy
create_Temperature, destroy_Temperature = _creator(lambda context: Temperature(context.settings.period_s)), _destroy
create_Network, destroy_Network = (
    _creator(lambda context: Network(context.settings.interface, context.clock, context.settings.period_s)),
    _destroy,
)
create_Uptime, destroy_Uptime = _creator(lambda _: Uptime()), _destroy
