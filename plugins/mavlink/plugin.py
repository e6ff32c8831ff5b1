"""The mavlink plugin: a rover or copter that speaks MAVLink."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from eal_actors.plugin import EALPlugin, PluginContext, PoseResource, Resource

from .autopilot import Autopilot
from .base import Base
from .link import MavLink
from .resources import Altitude, Battery, Odometry
from .settings import Settings

__all__ = ["Settings"]

_MAKERS: Final[dict[str, Callable[[PluginContext], Resource]]] = {
    "Base": lambda context: Base(context, context.plugin.link),
    "Odometry": lambda context: Odometry(context.plugin.link),
    "Pose": lambda context: PoseResource(context.localizer, context.clock),
    "Altitude": lambda context: Altitude(context.plugin.link),
    "Battery": lambda context: Battery(context.plugin.link),
    "Autopilot": lambda context: Autopilot(context.plugin.link, context.settings, context.clock),
}


class MavlinkPlugin(EALPlugin):
    """The link to one vehicle."""

    def __init__(self, link: MavLink) -> None:
        super().__init__(*_MAKERS)
        self.link = link


def connect(context: PluginContext) -> MavlinkPlugin:
    """Open the link; an absent vehicle is not ready, and reached when it appears."""
    return MavlinkPlugin(MavLink(context, context.settings))


def disconnect(plugin: MavlinkPlugin) -> None:
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
