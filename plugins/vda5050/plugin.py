"""The vda5050 plugin: an AGV that speaks VDA 5050 over MQTT."""

from __future__ import annotations

from eal_actors.plugin import FactoryPlugin, PluginContext, PoseResource

from .base import Base
from .link import AgvLink
from .resources import Actions, Battery, Factsheet, StateReport
from .settings import Settings

__all__ = ["Settings"]


class AgvPlugin(FactoryPlugin):
    """The link to one AGV."""

    def __init__(self, context: PluginContext, link: AgvLink) -> None:
        super().__init__(
            {
                "Base": lambda: Base(context, link),
                "Pose": lambda: PoseResource(context.localizer, context.clock),
                "Battery": lambda: Battery(link),
                "State": lambda: StateReport(link),
                "Actions": lambda: Actions(link),
                "Factsheet": lambda: Factsheet(link),
            }
        )
        self.link = link


def connect(context: PluginContext) -> AgvPlugin:
    """Open the link; an absent broker or AGV is not ready, and reached when it appears.

    Raises:
        PluginError: a certificate or the password cannot be read.

    Thread: the robot's; blocks at most two seconds of the fleet's clock.
    """
    link = AgvLink(context, context.settings)
    link.await_first_state()
    return AgvPlugin(context, link)


def disconnect(plugin: AgvPlugin) -> None:
    """Close the link."""
    plugin.link.close()
