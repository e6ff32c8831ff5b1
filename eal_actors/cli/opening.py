"""Opening a fleet for a command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from eal_actors.actors.handles import ResourceHandle
from eal_actors.errors import PluginError, Problem
from eal_actors.facade.fleet import Fleet
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.plugins import EALPluginManager


def read_fleet(
    path: Path, robots: Sequence[str] = (), *, rate: float | None = None, seed: int | None = None
) -> FleetConfig:
    """Read a fleet file.

    Args:
        path: the fleet file.
        robots: leave out all others; empty for all robots.
        rate: replaces the file's clock rate.
        seed: replaces the file's seed.

    Raises:
        ConfigError: everything that is wrong with the file.
        RobotNotFoundError: the fleet has no robot of one of the names.
    """
    manager = EALConfigManager.load(path)
    config = manager.fleet
    if robots:
        config = replace(config, robots={robot.name: robot for robot in manager.select(robots)})
    if rate is not None:
        config = replace(config, rate=rate)
    if seed is not None:
        config = replace(config, seed=seed)
    return config


def check_plugins(config: FleetConfig) -> tuple[set[Problem], list[str]]:
    """Return what the file says wrongly of its plugins, and which plugins cannot be read or imported here."""
    manager = EALPluginManager(config.plugin_dirs)
    problems: set[Problem] = set()
    broken = [str(error) for error in manager.errors]
    for robot in config.robots.values():
        wrong, unimportable = manager.check(robot)
        problems.update(wrong)
        broken += [error.message for error in unimportable]
    return problems, list(dict.fromkeys(broken))


def find_resource(fleet: Fleet, robot: str, resource: str) -> ResourceHandle:
    """Return a resource of a robot that must be up.

    Raises:
        RobotFailedError: the robot has failed.
        UnavailableError: the robot did not start in time.
        PluginError: the resource is not there, and a plugin that might hold it did not connect.
        ResourceNotFoundError: the robot has no such resource.
    """
    handle = fleet[robot]
    handle.wait_started(0.0)
    if resource not in handle and handle.problems:
        raise PluginError("; ".join(problem.message for problem in handle.problems), robot=robot)
    return handle[resource]
