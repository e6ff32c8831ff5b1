"""The system plugin: the computer that the robot's process runs on."""

# ruff: noqa: N816  # create_Cpu and its like are what the plugin API calls

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from eal_actors.plugin import EALPlugin, Field, PluginContext, PluginSettingsModel, Resource

from .gauges import Cpu, Disk, Memory, Network, Temperature, Uptime

Gauge = Literal["Cpu", "Memory", "Disk", "Temperature", "Network", "Uptime"]


class Settings(PluginSettingsModel):
    """What the fleet file may set."""

    resources: tuple[Gauge, ...] = Field(
        default=("Cpu", "Memory", "Disk", "Temperature", "Network", "Uptime"), min_length=1, strict=False
    )
    """Which there are."""
    disk: str = Field(default="/", min_length=1)
    """A path on the file system that `Disk` tells of; not one on another machine, which may not answer."""
    interface: str | None = Field(default=None, min_length=1)
    """The network interface, such as wlan0; all but the loopback together if it is left out."""
    period_s: float = Field(default=1.0, ge=0.1, le=3600)
    """How often `Cpu`, `Temperature` and `Network` are read."""


def connect(context: PluginContext) -> EALPlugin:
    """Name the resources."""
    settings: Settings = context.settings
    return EALPlugin(*settings.resources)


def disconnect(plugin: EALPlugin) -> None:
    """Let go of what `connect` took: nothing."""


def _creator(make: Callable[[PluginContext], Resource]) -> Callable[[PluginContext], Resource]:
    def create(context: PluginContext) -> Resource:
        """Make the resource."""
        return make(context)

    return create


def _destroy(resource: Resource) -> None:
    """Let go of what `create_...` took: nothing."""


create_Cpu, destroy_Cpu = _creator(lambda context: Cpu(context.settings.period_s)), _destroy
create_Memory, destroy_Memory = _creator(lambda _: Memory()), _destroy
create_Disk, destroy_Disk = _creator(lambda context: Disk(context.settings.disk)), _destroy
create_Temperature, destroy_Temperature = _creator(lambda context: Temperature(context.settings.period_s)), _destroy
create_Network, destroy_Network = (
    _creator(lambda context: Network(context.settings.interface, context.clock, context.settings.period_s)),
    _destroy,
)
create_Uptime, destroy_Uptime = _creator(lambda _: Uptime()), _destroy
