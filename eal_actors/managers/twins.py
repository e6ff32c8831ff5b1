"""Replaces every robot of a fleet by a simulated one, so that nothing real can move.

Which simulated robot replaces the robot of a driver is declared as `twin` in the driver's manifest.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final

from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.lock_step import MAX
from eal_actors.kernel.yaml_tree import MarkedDict, YamlTree, texts_in
from eal_actors.managers.fleet_model import FleetConfig, PluginSettings, RobotConfig
from eal_actors.managers.manifest import PluginManifest, TwinSection, discover, explain_unknown_plugin
from eal_actors.managers.missing_modules import require_modules

_CANNOT: Final = "cannot be simulated"


@dataclass(frozen=True, slots=True)
class SimulatedFleet:
    """A fleet of which every robot is simulated.

    Attributes:
        replaced: by robot, the simulated robot that replaces it.
        left_out: by robot, why it, or some of its plugins, are left out.
        bodies: by robot, the name of its body in the world.
    """

    config: FleetConfig
    replaced: Mapping[str, str]
    left_out: Mapping[str, str]
    bodies: Mapping[str, str]


def simulated(config: FleetConfig, needed: Iterable[str], keep: Collection[str] = ()) -> SimulatedFleet:
    """Return the fleet with simulated robots only.

    A simulated robot, a driver on a simulated port, and a plugin with simulated cameras stay as they are, without their
    other plugins. The robot of a driver is replaced by the driver's twin. Robots with an address become local. Robots
    that are not `needed` and cannot be simulated are left out. Plugins to `keep` move nothing real, and stay.

    Raises:
        ConfigError: a needed robot cannot be simulated.
        PluginError: modules are not installed, so that no robot can be.
    """
    builder = _TwinBuilder(config, frozenset(keep))
    required = frozenset(needed)
    robots: dict[str, RobotConfig] = {}
    problems: list[Problem] = []
    for name, robot in config.robots.items():
        result = builder.simulate(robot)
        if isinstance(result, RobotConfig):
            robots[name] = result
        elif name in required:
            problems.append(result)
        else:
            builder.left_out[name] = result.message
    if problems:
        raise ConfigError(problems)
    fleet = replace(config, robots=robots, rate=MAX)
    require_modules(fleet, robots)
    return SimulatedFleet(fleet, builder.replaced, builder.left_out, builder.bodies)


class _TwinBuilder:
    """Builds the simulated robots of one fleet."""

    def __init__(self, config: FleetConfig, keep: frozenset[str]) -> None:
        self.replaced: dict[str, str] = {}
        self.left_out: dict[str, str] = {}
        self.bodies: dict[str, str] = {}
        self._config = config
        self._keep = keep
        manifests, self._errors = discover(config.plugin_dirs)
        self._manifests = manifests
        self._twins = {name: found.file.twin for name, found in manifests.items() if found.file.twin is not None}
        self._worlds = world_urls(manifests)

    def simulate(self, robot: RobotConfig) -> RobotConfig | Problem:
        """Return the simulated robot, or why there is none."""
        local = replace(robot, address=None, listen=None)
        kept = {n: one for n, one in robot.plugins.items() if one.plugin in self._keep or self._observes_world(one)}
        bodies = {name: body for name, one in robot.plugins.items() if (body := self._body_of(robot, one)) is not None}
        if not bodies:
            return self._replace(local, kept)
        stays = {name: one for name, one in robot.plugins.items() if name in kept or name in bodies}
        if dropped := [one.plugin for name, one in robot.plugins.items() if name not in stays]:
            self.left_out[robot.name] = f"its plugins that are not simulated: {_join(dropped)}"
        self.bodies[robot.name] = next(iter(bodies.values()))
        return replace(local, plugins=stays)

    def _replace(self, robot: RobotConfig, kept: Mapping[str, PluginSettings]) -> RobotConfig | Problem:
        drivers = [(one, twin) for one in robot.plugins.values() if (twin := self._twins.get(one.plugin)) is not None]
        if len(drivers) == 1:
            driver, twin = drivers[0]
            if twin.plugin not in self._manifests:
                unknown = explain_unknown_plugin(twin.plugin, self._manifests, self._errors)
                return driver.problem(
                    (), f"{_CANNOT}: the manifest of {driver.plugin} names a twin that is not installed: {unknown}"
                )
            self.replaced[robot.name] = f"simulated by {_describe(twin)} in place of {driver.plugin}"
            self.bodies[robot.name] = robot.name
            return replace(robot, plugins={twin.plugin: _settings(robot.name, driver, twin), **kept})
        if kept and len(kept) == len(robot.plugins):
            return robot
        if not robot.plugins:
            why = "the fleet file names no plugins, because the robot is served elsewhere"
            return Problem(str(self._config.source), 0, 0, f"robots.{robot.name}", f"{_CANNOT}: {why}")
        first = next(one for one in robot.plugins.values() if one.plugin not in self._keep)
        why = (
            f"{' and '.join(one.plugin for one, _ in drivers)} each have a twin, and a robot has one body"
            if drivers
            else f"no twin is declared for {_join(one.plugin for one in robot.plugins.values())}; plugins with a twin: "
            f"{', '.join(self._twins)}"
        )
        return first.problem((), f"{_CANNOT}: {why}")

    def _observes_world(self, plugin: PluginSettings) -> bool:
        """Return whether a plugin has a part, such as one of its cameras, in the simulated world."""
        parts = (value for value in plugin.settings.values() if not isinstance(value, str))
        return any(text.startswith(tuple(self._worlds.values())) for part in parts for text in texts_in(part))

    def _body_of(self, robot: RobotConfig, plugin: PluginSettings) -> str | None:
        """Return the body that a plugin drives in the simulated world; None if it is not simulated."""
        if plugin.plugin in self._worlds:
            return robot.name
        texts = [value for value in plugin.settings.values() if isinstance(value, str)]
        for world in self._worlds.values():
            for text in texts:
                if text.startswith(world):
                    return text.removeprefix(world).strip("/") or robot.name
        return None


def world_urls(manifests: Mapping[str, PluginManifest]) -> dict[str, str]:
    """Return, by the plugin that simulates it, the URL of a simulated world, under which its ports are."""
    return {
        name: f"{simulation.scheme or name}://world"
        for name, manifest in manifests.items()
        if (simulation := manifest.file.simulation) is not None
    }


def _describe(twin: TwinSection) -> str:
    settings = ", ".join(f"{key}: {value}" for key, value in twin.settings.items())
    return f"{twin.plugin} ({settings})" if settings else twin.plugin


def _settings(robot: str, driver: PluginSettings, twin: TwinSection) -> PluginSettings:
    """Return the twin's settings; problems with them point to the driver's settings."""
    mark = driver.tree.root.mark
    root = MarkedDict(mark)
    for key, value in twin.settings.items():
        root.put(key, value, mark, mark)
    return PluginSettings(twin.plugin, twin.plugin, YamlTree(root, ("robots", robot, "plugins", driver.instance)))


def _join(names: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(names))
