"""Reading, checking and opening the fleet of a command."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from eal_actors.actors.handles import ResourceHandle
from eal_actors.cli.exit_codes import SEE_DEVICE, advise_on_device
from eal_actors.cli.output import stderr
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import short_path
from eal_actors.kernel.errors import PluginError, Problem, RobotFailedError
from eal_actors.kernel.lock_step import MAX, Rate
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.plugins import EALPluginManager
from eal_actors.managers.shared_ports import shared_ports


def read_fleet(
    path: Path, robots: Sequence[str] = (), *, rate: Rate | None = None, seed: int | None = None
) -> FleetConfig:
    """Read a fleet file, or some of its robots; a rate and a seed replace those of the file.

    Raises:
        ConfigError: the file is wrong; names every problem.
        RobotNotFoundError: the fleet has no robot of one of the names.
    """
    manager = EALConfigManager.load(path)
    config = manager.fleet
    if robots:
        config = replace(config, robots={robot.name: robot for robot in manager.select(robots)})
    if rate is not None:
        config = replace(config, rate=rate)
    return config if seed is None else replace(config, seed=seed)


def in_real_time(config: FleetConfig) -> FleetConfig:
    """Return the fleet with a rate that people can follow."""
    if config.rate != MAX:
        return config
    stderr().print("the fleet's clock runs at rate 1 instead of max", style="dim", soft_wrap=True)
    return replace(config, rate=1.0)


def check_plugins(config: FleetConfig) -> tuple[set[Problem], list[str]]:
    """Return the problems of the plugins that a fleet uses and of their ports, and warnings.

    Warnings depend on this machine: plugins that cannot be read, which the fleet may not use, and missing modules.
    """
    manager = EALPluginManager(config.plugin_dirs)
    problems = set(shared_ports(config.robots.values(), manager.manifests))
    problems.update(manager.check_together(config.robots.values(), config.world))
    warnings = [str(error) for error in manager.errors]
    for robot in config.robots.values():
        for instance, settings in robot.plugins.items():
            wrong, broken = manager.check(replace(robot, plugins={instance: settings}))
            problems.update(wrong)
            for error in broken:
                if manager.manifests[settings.plugin].missing_modules():
                    warnings.append(error.message)
                else:
                    problems.add(settings.problem((), error.message))
    return problems, list(dict.fromkeys(warnings))


@contextmanager
def plugin_advice(fleet: Fleet) -> Iterator[None]:
    """Add a note to an error that a plugin caused which did not connect: what to do about that plugin."""
    try:
        yield
    except (PluginError, RobotFailedError) as error:
        for problem in fleet.problems:
            if isinstance(problem, PluginError) and problem.message in str(error):
                for advice in _advice(fleet.config, problem):
                    if advice not in getattr(error, "__notes__", ()):
                        error.add_note(advice)
        raise


def _advice(config: FleetConfig, problem: PluginError) -> Iterator[str]:
    folder = "FOLDER"
    manifests = EALPluginManager(config.plugin_dirs).manifests
    robot = config.robots.get(problem.robot or "")
    for settings in robot.plugins.values() if robot is not None else ():
        manifest = manifests.get(settings.plugin)
        if manifest is not None and f"plugin {manifest.name!r}" in problem.message:
            folder = str(short_path(manifest.folder))
            if manifest.missing_modules():
                yield "Install what is missing, then try again."  # the error itself names the modules
                return
    if isinstance(problem.__cause__, PluginError):  # not a mistake of the plugin
        yield "Correct its settings in the fleet file."
        return
    if isinstance(problem.__cause__, OSError):
        yield advise_on_device(problem.message) or SEE_DEVICE
    yield f"Details: `eal plugin check {folder}`"


def find_resource(fleet: Fleet, robot: str, resource: str) -> ResourceHandle:
    """Return a resource of a robot that has started.

    Raises:
        RobotFailedError: the robot has failed.
        UnavailableError: the robot did not start in time.
        PluginError: the robot lacks the resource, and one of its plugins did not connect.
        ResourceNotFoundError: the robot has no such resource.
    """
    handle = fleet[robot]
    handle.require_started()
    if resource not in handle and handle.problems:
        raise PluginError("; ".join(problem.message for problem in handle.problems), robot=robot)
    return handle[resource]
