"""The mavlink plugin: a rover or copter that speaks MAVLink."""

from __future__ import annotations

from eal_actors.plugin import FactoryPlugin, PluginContext, PoseResource

from .autopilot import Autopilot
from .base import Base
from .link import MavLink
from .resources import Altitude, Battery, Odometry
from .settings import Settings

__all__ = ["Settings"]


class MavlinkPlugin(FactoryPlugin):
    """The link to one vehicle."""

    def __init__(self, context: PluginContext, link: MavLink) -> None:
        super().__init__(
            {
                "Base": lambda: Base(context, link),
                "Odometry": lambda: Odometry(link),
                "Pose": lambda: PoseResource(context.localizer, context.clock),
                "Altitude": lambda: Altitude(link),
                "Battery": lambda: Battery(link),
                "Autopilot": lambda: Autopilot(link, context.settings),
            }
        )
        self.link = link


def connect(context: PluginContext) -> MavlinkPlugin:
    """Open the link; an absent vehicle is not ready, and reached when it appears."""
    return MavlinkPlugin(context, MavLink(context, context.settings))


def disconnect(plugin: MavlinkPlugin) -> None:
    """Close the link."""
    plugin.link.close()
