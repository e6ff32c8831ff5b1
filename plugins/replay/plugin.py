"""The replay plugin: sensors return recorded values, commands take their recorded time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from eal_actors.plugin import EALError, EALPlugin, Field, PluginContext, PluginError, PluginSettingsModel, Resource
from eal_actors.recording.recorded_run import RecordedRun

from .player import Player
from .resource import Replayed


class Settings(PluginSettingsModel):
    """The plugin's settings in the fleet file."""

    record: str = Field(min_length=1)
    """The `run.mcap` of the run, or its folder; relative to the working directory."""
    robot: str | None = None
    """The robot of the record; default: the one of the same name."""
    loop: bool = False
    """Restart at the end. Otherwise the robot is not ready after the end."""


class ReplayPlugin(EALPlugin):
    """One robot of a record.

    Args:
        player: plays the record.
        robot: the robot's name in the record.
    """

    def __init__(self, player: Player, robot: str) -> None:
        super().__init__(*(name for name in player.run.infos[robot] if player.run.has(robot, name)))
        self.player = player
        self.robot = robot


def connect(context: PluginContext) -> ReplayPlugin:
    """Read the record, once for all robots of the fleet.

    Raises:
        PluginError: there is no such record, or the robot is not in it.
    """
    settings: Settings = context.settings
    path, robot = _file(settings.record), settings.robot or context.robot
    player: Player = context.services.shared(("replay", path, settings.loop), lambda: _open(context, path))
    if robot not in player.run.infos:
        raise PluginError(f"the record {path} has no robot {robot!r}; it has {', '.join(player.run.infos)}")
    if not any(player.run.has(robot, name) for name in player.run.infos[robot]):
        raise PluginError(f"the record {path} has neither values nor calls of robot {robot!r}")
    return ReplayPlugin(player, robot)


def _file(record: str) -> Path:
    path = Path(record)
    return path / "run.mcap" if path.is_dir() else path


def _open(context: PluginContext, path: Path) -> Player:
    try:
        return Player(RecordedRun.open(path), context.clock, loop=context.settings.loop)
    except EALError as error:
        raise PluginError(f"robot {context.robot!r}: {error.message}") from error
    except OSError as error:
        raise PluginError(f"robot {context.robot!r}: cannot read the record {path}: {error.strerror}") from error


def disconnect(plugin: ReplayPlugin) -> None:
    """Do nothing."""


def __getattr__(name: str) -> Callable[..., Any]:
    """Return `create_<Resource>` or `destroy_<Resource>`, because the record names the resources."""
    action, _, resource = name.partition("_")
    if action == "create" and resource:

        def create(context: PluginContext) -> Resource:
            """Create the resource."""
            return Replayed(context.plugin.player, context.plugin.robot, resource)

        return create
    if action == "destroy" and resource:
        return _destroy
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _destroy(resource: Resource) -> None:
    """Do nothing: the plugin owns the record."""
