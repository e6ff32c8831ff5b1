"""Completion in the shell: names of fleets, scenarios, robots and resources. `eal --install-completion` installs it.

What takes long to load is loaded by the functions: every command imports this module, and only a shell calls it.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from eal_actors.kernel.bundled import FLEET_VARIABLE, Kind, bundled_names
from eal_actors.kernel.errors import EALError

if TYPE_CHECKING:
    from eal_actors.managers.fleet_model import FleetConfig, RobotConfig


def complete_fleets(incomplete: str) -> list[str]:
    """Return bundled fleets and YAML files that begin with a text."""
    return _files_and_names("fleet", incomplete)


def complete_scenarios(incomplete: str) -> list[str]:
    """Return bundled scenarios and YAML files that begin with a text."""
    return _files_and_names("scenario", incomplete)


def complete_robots(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the robots of the command's fleet that begin with a text, but those that were given already."""
    fleet = _fleet_of(ctx)
    given = ctx.params.get("robots") or ()
    return [] if fleet is None else _beginning(incomplete, (name for name in fleet.robots if name not in given))


def complete_resources(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the resources that the plugins of the command's robot declare, and that begin with a text."""
    fleet, name = _fleet_of(ctx), ctx.params.get("robot")
    robot = None if fleet is None or name is None else fleet.robots.get(name)
    if fleet is None or robot is None:
        return []
    from eal_actors.managers.manifest import discover

    manifests, _ = discover(fleet.plugin_dirs)
    found = [manifests[one.plugin].file.resources for one in robot.plugins.values() if one.plugin in manifests]
    declared = dict.fromkeys(resource for resources in found for resource in resources)
    return _beginning(incomplete, declared if all(found) else _simulated_resources(fleet, robot))


def _simulated_resources(fleet: FleetConfig, robot: RobotConfig) -> list[str]:
    """Return the resources of a robot's simulated twin: those of some plugins depend on their settings."""
    from eal_actors.facade.fleet import Fleet
    from eal_actors.managers.twins import simulated

    try:
        twin = simulated(replace(fleet, robots={robot.name: robot}, rate=1.0), [robot.name])
        with Fleet(twin.config) as opened:
            return list(opened[robot.name])
    except EALError:
        return []


def _fleet_of(ctx: typer.Context) -> FleetConfig | None:
    """Return the fleet of `--fleet` or of the environment; None if it cannot be read: a shell shows no errors."""
    from eal_actors.managers.config import EALConfigManager

    chosen = ctx.params.get("fleet") or os.environ.get(FLEET_VARIABLE)
    try:
        return EALConfigManager.load(chosen).fleet if chosen else None
    except EALError:
        return None


def _files_and_names(kind: Kind, incomplete: str) -> list[str]:
    folder = Path(incomplete).parent if "/" in incomplete else Path()
    try:
        found = sorted(path for path in folder.iterdir() if path.suffix in (".yaml", ".yml") or path.is_dir())
    except OSError:
        found = []
    files = [f"{path}/" if path.is_dir() else str(path) for path in found if not path.name.startswith(".")]
    return _beginning(incomplete, [*bundled_names(kind), *files])


def _beginning(incomplete: str, names: Iterable[str]) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]
