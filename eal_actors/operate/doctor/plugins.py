"""Checks of a fleet's plugins: their imports and settings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from eal_actors.managers.fleet_model import FleetConfig, RobotConfig
from eal_actors.managers.manifest import PluginManifest
from eal_actors.managers.plugins import EALPluginManager
from eal_actors.operate.doctor.diagnostic import Diagnostic, ok, problem, warning

_AREA = "plugins"


def check_plugins(config: FleetConfig, here: Iterable[RobotConfig]) -> Iterator[Diagnostic]:
    """Yield diagnostics of the plugins of the robots that run on this machine, which are imported."""
    manager = EALPluginManager(config.plugin_dirs)
    for unread in manager.errors:
        yield warning(_AREA, str(unread), "Correct its plugin.yaml; other plugins are not affected.")
    here = list(here)
    problems = dict.fromkeys(manager.check_together(here, config.world))
    fine: set[str] = set()
    findings: dict[Diagnostic, None] = {}
    for robot in here:
        for instance, settings in robot.plugins.items():
            wrong, broken = manager.check(replace(robot, plugins={instance: settings}))
            problems.update(dict.fromkeys(wrong))
            findings.update((_broken(manager.manifests[settings.plugin], error.message), None) for error in broken)
            if not wrong and not broken:
                manifest = manager.manifests[settings.plugin]
                fine.add(f"{manifest.name} {manifest.file.plugin_version}")
    yield from findings
    for wrong_place in problems:
        yield problem("fleet file", str(wrong_place), "Correct the file there.")
    if fine:
        yield ok(_AREA, ", ".join(sorted(fine)))


def _broken(manifest: PluginManifest, message: str) -> Diagnostic:
    if not manifest.missing_modules():
        return problem(_AREA, message, f"eal plugin check {manifest.folder}")
    what, _, remedy = message.partition(": pip install ")
    return problem(_AREA, what, f"pip install {remedy}" if remedy else "Install the missing packages.")
