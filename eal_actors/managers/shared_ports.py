"""Ports that two robots of a fleet would open: each of them would take the other's bytes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from eal_actors.kernel.errors import Problem
from eal_actors.managers.fleet_model import RobotConfig
from eal_actors.managers.manifest import DeviceSection, PluginManifest
from eal_actors.managers.network_model import BEHIND_ROUTER, is_loopback, parse_endpoint


def shared_ports(robots: Iterable[RobotConfig], manifests: Mapping[str, PluginManifest]) -> Iterator[Problem]:
    """Yield a problem for each setting that names a device of another robot, or of another plugin of the robot.

    Devices are those that the plugins' manifests declare. Two names of one device count as one, if it is plugged in.
    """
    owners: dict[tuple[str, str], str] = {}
    for robot in robots:
        for plugin in robot.plugins.values():
            manifest = manifests.get(plugin.plugin)
            for section in manifest.file.devices if manifest is not None else ():
                if (device := _device(section, plugin.settings.get(section.setting))) is None:
                    continue
                owner = owners.setdefault((_machine(robot), device), f"{robot.name} ({plugin.instance})")
                if owner != f"{robot.name} ({plugin.instance})":
                    yield plugin.problem((section.setting,), f"{device} is used by {owner} already: one robot a port")


def _device(section: DeviceSection, value: Any) -> str | None:
    """Return the device that a setting names: its path without links, or its URL."""
    is_camera = section.kind == "camera"
    text = f"/dev/video{value}" if is_camera and type(value) is int else value
    if not isinstance(text, str) or (is_camera and not text.startswith("/dev/")):  # many may play one file
        return None
    return str(Path(text).resolve()) if text.startswith("/") else text


def _machine(robot: RobotConfig) -> str:
    """Return the name of the machine that runs a robot; empty for this one."""
    if robot.address is None:
        return ""
    if robot.address == BEHIND_ROUTER:
        return robot.name  # it may be anywhere
    host = parse_endpoint(robot.address).host
    return "" if is_loopback(host) else host
