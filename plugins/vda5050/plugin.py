"""The vda5050 plugin: an AGV that speaks VDA 5050 over MQTT."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from eal_actors.plugin import EALPlugin, PluginContext, PoseResource, Resource

from .base import Base
from .link import AgvLink
from .resources import Actions, Battery, Factsheet, StateReport
from .settings import Settings

__all__ = ["Settings"]

_MAKERS: Final[dict[str, Callable[[PluginContext], Resource]]] = {
    "Base": lambda context: Base(context, context.plugin.link),
    "Pose": lambda context: PoseResource(context.localizer, context.clock),
    "Battery": lambda context: Battery(context.plugin.link),
    "State": lambda context: StateReport(context.plugin.link),
    "Actions": lambda context: Actions(context.plugin.link),
    "Factsheet": lambda context: Factsheet(context.plugin.link),
}


class AgvPlugin(EALPlugin):
    """The link to one AGV."""

    def __init__(self, link: AgvLink) -> None:
        super().__init__(*_MAKERS)
        self.link = link


def connect(context: PluginContext) -> AgvPlugin:
    """Open the link; an absent broker or AGV is not ready, and reached when it appears.

    Raises:
        PluginError: a certificate or the password cannot be read.
    """
    return AgvPlugin(AgvLink(context, context.settings))


def disconnect(plugin: AgvPlugin) -> None:
    """Close the link."""
    plugin.link.close()


def __getattr__(name: str) -> Callable[..., Any]:
    """Return `create_<Resource>` or `destroy_<Resource>`."""
    action, _, resource = name.partition("_")
    if action == "create" and resource in _MAKERS:
        return _MAKERS[resource]
    if action == "destroy" and resource in _MAKERS:
        return _destroy
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _destroy(resource: Resource) -> None:
    """Do nothing: the link is the plugin's."""
