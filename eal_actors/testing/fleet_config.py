"""Fleet configuration from a test's short description of robots and world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeAlias

from eal_actors.device.world import WorldModel, load_world
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import ConfigError, Problem, file_error
from eal_actors.kernel.lock_step import MAX
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.managers.config import EALConfigManager, collect_problems, world_of
from eal_actors.managers.fleet_model import FleetConfig, RobotSection
from eal_actors.managers.manifest import simulating_plugin

Robots: TypeAlias = Mapping[str, str | Mapping[str, Any]] | str | Path
"""Maps each robot's name to its model or settings; or a fleet file."""

World: TypeAlias = str | Path | WorldModel | Mapping[str, Any]
"""Name of a bundled world, a world file, a model, or the content of a world file."""

_NAME: Final = "simulation"
_EMPTY: Final = "empty"
_ROBOT_KEYS: Final = frozenset(RobotSection.model_fields)


def simulated_fleet(
    robots: Robots, world: World | None, seed: int | None, plugin_dirs: Sequence[str | Path]
) -> FleetConfig:
    """Return the configuration of a fleet whose clock runs as fast as possible; arguments as for Simulation.

    Raises ConfigError with every problem of the robots and the world.
    """
    problems: list[Problem] = []
    config = collect_problems(problems, lambda: _fleet(robots, seed, plugin_dirs))
    wanted = _EMPTY if world is None and isinstance(robots, Mapping) else world
    arena = collect_problems(problems, lambda: None if wanted is None else _world(wanted))
    if config is None or problems:
        raise ConfigError(problems)
    return replace(config, rate=MAX, world=arena or config.world)


def _fleet(robots: Robots, seed: int | None, plugin_dirs: Sequence[str | Path]) -> FleetConfig:
    content: dict[str, object] = {"version": 1, "plugin_dirs": tuple(plugin_dirs)}
    if seed is not None:
        content["seed"] = seed
    if isinstance(robots, Mapping):
        simulator = simulating_plugin(Path(folder) for folder in plugin_dirs).name
        content["robots"] = {name: _robot(name, entry, simulator) for name, entry in robots.items()}
        return EALConfigManager.of(content, name=_NAME).fleet
    file = EALConfigManager.load(robots).fleet
    content |= {"include": [file.source], "name": file.name, "plugin_dirs": (*plugin_dirs, *file.plugin_dirs)}
    return replace(EALConfigManager.of(content, name=_NAME).fleet, source=file.source)


def _robot(name: str, entry: object, simulator: str) -> object:
    """Return a robot of a fleet file; keys unknown to robots are settings of the simulation's plugin."""
    if isinstance(entry, str):
        return {"plugins": {simulator: {"model": entry}}}
    if not isinstance(entry, Mapping):
        return entry
    robot = {key: value for key, value in entry.items() if key in _ROBOT_KEYS}
    settings = {key: value for key, value in entry.items() if key not in _ROBOT_KEYS}
    if not settings:
        return robot
    if "start" in settings:
        settings["start"] = _start(name, settings["start"])
    plugins = robot.get("plugins", {})
    if isinstance(plugins, Mapping):
        if simulator in plugins:
            message = (
                f"has settings in two places, also here: {', '.join(map(str, settings))}; put all of them in one place"
            )
            raise file_error(_NAME, message, f"robots.{name}.plugins.{simulator}")
        robot["plugins"] = {simulator: settings, **plugins}
    return robot


def _start(robot: str, start: object) -> object:
    if not isinstance(start, list | tuple):
        return start
    if len(start) not in (2, 3):
        raise file_error(_NAME, f"must be (x_m, y_m) or (x_m, y_m, yaw_deg), not {start!r}", f"robots.{robot}.start")
    return dict(zip(("x_m", "y_m", "yaw_deg"), start, strict=False))


def _world(world: World) -> WorldModel:
    if isinstance(world, WorldModel | Mapping):
        return world_of(world)
    if isinstance(world, Path) or Path(world).suffix or len(Path(world).parts) > 1:
        return load_world(world)
    file = bundled_path("fleets/worlds") / f"{world}.yaml"
    if not file.is_file():
        known = did_you_mean(world, (file.stem for file in file.parent.glob("*.yaml")))
        raise file_error(_NAME, f"there is no bundled world {world!r}{known}", "world")
    return load_world(file)
