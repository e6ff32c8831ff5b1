"""Fleet files of a proof: every robot in full, so that faults can be added and robots be left out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final

import yaml

from eal_actors.kernel.lock_step import MAX
from eal_actors.kernel.yaml_tree import plain
from eal_actors.lab.proof.cases import InjectedFault
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig, Level, RobotConfig
from eal_actors.managers.manifest import FaultSection, discover

Content = Mapping[str, Any]
"""The content of a fleet file."""

KEYS_OF_ROBOTS: Final = ("tags", "timeout_s", "mailbox", "restart", "max_restarts", "restart_window_s", "exclusive")
"""The keys of a robot that change how it is run."""
FAULTS = "faults"
"""The setting of a simulating plugin that lists the faults of its robot."""


def fleet_content(config: FleetConfig, world: Path | None) -> dict[str, Any]:
    """Return a fleet whose clock runs as fast as possible, without includes, defaults, and counts of robots."""
    types: dict[str, Any] = {}
    for robot in config.robots.values():
        for inner, base in zip_longest(robot.types, robot.types[1:]):
            types[inner] = {} if base is None else {"type": base}
    files = {"world": str(world) if world else None, "map": str(config.map_path) if config.map_path else None}
    lists = {"plugin_dirs": [str(folder) for folder in config.plugin_dirs], "python_steps": list(config.python_steps)}
    return {
        "version": 1,
        "name": config.name,
        "seed": config.seed,
        "clock": {"rate": MAX},
        **{key: value for key, value in {**files, **lists, "types": types}.items() if value},
        "robots": {name: _robot_content(robot) for name, robot in config.robots.items()},
    }


def _robot_content(robot: RobotConfig) -> dict[str, Any]:
    plugins = {
        name: ({} if one.plugin == name else {"plugin": one.plugin}) | dict(plain(one.settings))
        for name, one in robot.plugins.items()
    }
    values = {key: getattr(robot, key) for key in KEYS_OF_ROBOTS}
    changed = {key: value for key, value in values.items() if value != Level.model_fields[key].default}
    pose = robot.pose.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    listed = {key: list(value) if isinstance(value, tuple) else value for key, value in changed.items()}
    own_type = {"type": robot.type} if robot.type is not None else {}
    return own_type | listed | ({"pose": pose} if pose else {}) | {"plugins": plugins}


def injectable_faults(config: FleetConfig) -> dict[str, tuple[str, Mapping[str, FaultSection]]]:
    """Return, by robot, the instance of the plugin that simulates it, and the faults that its manifest declares."""
    manifests, _ = discover(config.plugin_dirs)
    simulations = {
        name: found.file.simulation.faults
        for name, found in manifests.items()
        if found.file.simulation is not None and found.file.simulation.faults
    }
    return {
        name: (instance, simulations[one.plugin])
        for name, robot in config.robots.items()
        for instance, one in robot.plugins.items()
        if one.plugin in simulations
    }


def with_quick_settings(content: Content, plugin_dirs: Iterable[Path]) -> Content:
    """Return a fleet whose plugins have the settings that their manifests declare as quick."""
    manifests, _ = discover(plugin_dirs)

    def quick(instance: str, settings: Mapping[str, Any]) -> dict[str, Any]:
        manifest = manifests.get(settings.get("plugin", instance))
        return {**settings, **(manifest.file.quick if manifest is not None else {})}

    robots = {
        name: {**robot, "plugins": {instance: quick(instance, one) for instance, one in robot["plugins"].items()}}
        for name, robot in content["robots"].items()
    }
    return {**content, "robots": robots}


def with_faults(content: Content, faults: Iterable[InjectedFault]) -> Content:
    """Return a fleet with more faults of its robots; faults of the controller are not among them."""
    robots = dict(content["robots"])
    for fault in faults:
        if not fault.settings:
            continue
        robot = robots[fault.robot]
        settings = robot["plugins"][fault.instance]
        times = {"at_s": fault.at_s} | ({} if fault.until_s is None else {"until_s": fault.until_s})
        planned = [*settings.get(FAULTS, ()), {**times, **fault.settings}]
        robots[fault.robot] = with_plan(robot, fault.instance, planned)
    return {**content, "robots": robots}


def with_plan(robot: Mapping[str, Any], instance: str, plan: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return a robot whose simulating plugin has these planned faults in place of its own."""
    plugins = {**robot["plugins"], instance: {**robot["plugins"][instance], FAULTS: list(plan)}}
    return {**robot, "plugins": plugins}


def load_content(content: Content, source: Path) -> FleetConfig:
    """Return a fleet; python steps are found beside its source; raise ConfigError if the content is invalid."""
    return replace(EALConfigManager.of(content, name=str(content["name"])).fleet, source=source)


def write_fleet(content: Content, comments: Iterable[str], file: Path) -> None:
    """Write a fleet file that begins with comments; raise OSError if it cannot be written."""
    head = "".join(f"# {line}\n" for comment in comments for line in comment.splitlines())
    text = yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True, width=120)
    file.write_text(head + text, encoding="utf-8")
