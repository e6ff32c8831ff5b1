"""The replay plugin: sensors return recorded values, commands take their recorded time."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from eal_actors.plugin import (
    EALError,
    FactoryPlugin,
    Field,
    PluginContext,
    PluginError,
    PluginSettingsModel,
    ResourceType,
)
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


def connect(context: PluginContext) -> FactoryPlugin:
    """Read the record, once for all robots of the fleet.

    Raises:
        PluginError: there is no such record, or the robot is not in it.
    """
    settings: Settings = context.settings
    path, robot = _file(settings.record), settings.robot or context.robot
    player: Player = context.services.shared(("replay", path, settings.loop), lambda: _open(context, path))
    if robot not in player.run.infos:
        raise PluginError(f"the record {path} has no robot {robot!r}; it has {', '.join(player.run.infos)}")
    names = [name for name in player.run.infos[robot] if player.run.has(robot, name)]
    if not names:
        raise PluginError(f"the record {path} has neither values nor calls of robot {robot!r}")
    makers = {name: partial(Replayed, player, robot, name) for name in names}
    return FactoryPlugin(makers, tuple(_lacking(player.run, robot)))


def _lacking(run: RecordedRun, robot: str) -> Iterator[str]:
    """Yield the sensors that the record does not hold, with the option of `eal run` that records them."""
    infos = run.infos[robot].values()
    lacking = [
        info for info in infos if ResourceType.SENSOR in info.types and info.value and not run.has(robot, info.name)
    ]
    for option, is_camera in (("sensors", False), ("all", True)):
        if names := [info.name for info in lacking if info.is_camera is is_camera]:
            yield f"the record lacks {', '.join(names)}, which `--record {option}` records"


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


def disconnect(plugin: FactoryPlugin) -> None:
    """Do nothing: the fleet owns the record."""
