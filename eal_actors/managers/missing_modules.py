"""Packages that are not installed: those of a fleet, reported once before anything starts, and those of our extras."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from eal_actors.kernel.errors import PluginError, UnsupportedError
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.manifest import discover


@contextmanager
def needs_extra(extra: str, what: str) -> Iterator[None]:
    """Turn a failed import into the advice to install our extra, after a beginning such as `metrics need`.

    Raises UnsupportedError if the package is not installed, or cannot be loaded.
    """
    try:
        yield
    except ImportError as error:
        why = f"{error.name}, which is not installed" if isinstance(error, ModuleNotFoundError) else str(error)
        raise UnsupportedError(f"{what} {why}: pip install 'eal-actors[{extra}]'") from error


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
