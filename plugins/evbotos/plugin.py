"""The evbotos plugin: updates of the machine that runs the robot's process."""

# ruff: noqa: N802  # the plugin API requires names such as create_Update

from __future__ import annotations

from pathlib import Path

from eal_actors.plugin import EALPlugin, Field, PluginContext, PluginSettingsModel

from .root_side import RootSide
from .update import Update


class Settings(PluginSettingsModel):
    """The plugin's settings in the fleet file."""

    state: str = Field(default="/run/evbotos", min_length=1)
    """The folder where EvBotOS keeps its state."""
    about: str = Field(default="/etc/evbotos", min_length=1)
    """The folder where EvBotOS describes its image."""


def connect() -> EALPlugin:
    """Name the resource."""
    return EALPlugin("Update")


def disconnect(plugin: EALPlugin) -> None:
    """Do nothing."""


def create_Update(context: PluginContext) -> Update:
    """Create the resource."""
    settings: Settings = context.settings
    return Update(RootSide(Path(settings.state), context.clock), Path(settings.about))


def destroy_Update(resource: Update) -> None:
    """Do nothing; `close` ended the connection."""
