"""The system plugin: gauges of the computer that runs the robot's process."""

from __future__ import annotations

from typing import Literal

from eal_actors.plugin import FactoryPlugin, Field, PluginContext, PluginSettingsModel

from .gauges import Cpu, Disk, Memory, Network, Temperature, Uptime, temperatures_c

Gauge = Literal["Cpu", "Memory", "Disk", "Temperature", "Network", "Uptime"]


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


def connect(context: PluginContext) -> FactoryPlugin:
    """Name the resources."""
    settings: Settings = context.settings
    makers = {
        "Cpu": lambda: Cpu(settings.period_s),
        "Memory": Memory,
        "Disk": lambda: Disk(settings.disk),
        "Temperature": lambda: Temperature(settings.period_s),
        "Network": lambda: Network(settings.interface, context.clock, settings.period_s),
        "Uptime": Uptime,
    }
    found = [gauge for gauge in makers if gauge != "Temperature" or temperatures_c()]
    return FactoryPlugin({gauge: makers[gauge] for gauge in settings.resources or found})


def disconnect(plugin: FactoryPlugin) -> None:
    """Do nothing."""
