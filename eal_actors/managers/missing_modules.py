"""The check that what a fleet needs is installed: reported once, before anything starts."""

from __future__ import annotations

from collections.abc import Iterable

from eal_actors.kernel.errors import PluginError
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.manifest import discover


def require_modules(config: FleetConfig, robots: Iterable[str]) -> None:
    """Raise one PluginError for all robots if none of them can start here, because modules are not installed."""
    manifests, _ = discover(config.plugin_dirs)
    missing: dict[str, None] = {}
    for robot in (config.robots[name] for name in robots):
        used = [manifests.get(settings.plugin) for settings in robot.plugins.values()]
        reasons = [manifest.lacks() for manifest in used if manifest is not None]
        if robot.address is not None or not reasons or not all(reasons):
            return
        missing |= dict.fromkeys(reasons)
    if missing:
        error = PluginError("; ".join(missing))
        error.add_note("Install what is missing, then try again.")
        raise error
