"""The evbotos plugin: updates of the machine that runs the robot's process."""

from __future__ import annotations

from pathlib import Path

from eal_actors.plugin import FactoryPlugin, Field, PluginContext, PluginSettingsModel

from .root_side import RootSide
from .update import Update


class Settings(PluginSettingsModel):
    """The plugin's settings in the fleet file."""

    state: str = Field(default="/run/evbotos", min_length=1)
    """The folder where EvBotOS keeps its state."""
    about: str = Field(default="/etc/evbotos", min_length=1)
    """The folder where EvBotOS describes its image."""


def connect(context: PluginContext) -> FactoryPlugin:
    """Name the resource."""
    settings: Settings = context.settings
    return FactoryPlugin(
        {"Update": lambda: Update(RootSide(Path(settings.state), context.clock), Path(settings.about))}
    )


def disconnect(plugin: FactoryPlugin) -> None:
    """Do nothing; the resource has closed its connection."""
