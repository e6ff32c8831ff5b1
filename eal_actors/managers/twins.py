"""Replaces every robot of a fleet by a simulated one, so that nothing real can move.

Which simulated robot replaces the robot of a driver is declared as `twin` in the driver's manifest.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.lock_step import MAX
from eal_actors.kernel.yaml_tree import MarkedDict, YamlTree
from eal_actors.managers.fleet_model import FleetConfig, PluginSettings, RobotConfig
from eal_actors.managers.manifest import (
    TwinSection,
    discover,
    explain_unknown_plugin,
    names_world,
    world_urls,
)
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

    A simulated robot, a driver on a simulated port, and a plugin with simulated cameras stay as they are. The robot of
    a driver is replaced by the driver's twin, and a sensor by its own, at a port of the simulated world. Their other
    plugins are left out. Robots with an address become local. Robots that are not `needed` and cannot be simulated are
    left out. Plugins to `keep` move nothing real, and stay.

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
        sensors = self._sensors_of(robot, {*kept, *bodies})
        if not bodies:
            return self._replace(local, kept, sensors)
        if sensors:
            self.replaced[robot.name] = f"with simulated {_join(one.plugin for one in sensors.values())}"
        stays = {name: one for name, one in robot.plugins.items() if name in kept or name in bodies}
        if dropped := [one.plugin for name, one in robot.plugins.items() if name not in {*stays, *sensors}]:
            self.left_out[robot.name] = f"its plugins that are not simulated: {_join(dropped)}"
        self.bodies[robot.name] = next(iter(bodies.values()))
        return replace(local, plugins={**stays, **sensors})  # a sensor finds its robot in the world

    def _sensors_of(self, robot: RobotConfig, others: Collection[str]) -> dict[str, PluginSettings]:
        """Return the twins that are no robots, but at ports of one in the simulated world, by plugin instance."""
        twins = ((one, self._twins.get(one.plugin)) for name, one in robot.plugins.items() if name not in others)
        return {
            one.instance: _settings(robot.name, one, twin, one.instance)
            for one, twin in twins
            if twin is not None and names_world(twin.settings, self._manifests)
        }

    def _replace(
        self, robot: RobotConfig, kept: Mapping[str, PluginSettings], sensors: Mapping[str, PluginSettings]
    ) -> RobotConfig | Problem:
        others = (one for name, one in robot.plugins.items() if name not in sensors)
        drivers = [(one, twin) for one in others if (twin := self._twins.get(one.plugin)) is not None]
        if len(drivers) == 1:
            driver, twin = drivers[0]
            if twin.plugin not in self._manifests:
                unknown = explain_unknown_plugin(twin.plugin, self._manifests, self._errors)
                return driver.problem(
                    (), f"{_CANNOT}: the manifest of {driver.plugin} names a twin that is not installed: {unknown}"
                )
            replaced = _join([driver.plugin, *(one.plugin for one in sensors.values())])
            self.replaced[robot.name] = f"simulated by {_describe(twin)} in place of {replaced}"
            self.bodies[robot.name] = robot.name
            body = _settings(robot.name, driver, twin, twin.plugin)
            return replace(robot, plugins={twin.plugin: body, **sensors, **kept})
        if robot.plugins and robot.plugins.keys() <= {*kept, *sensors}:
            return replace(robot, plugins={**sensors, **kept})
        return self._why_not(robot, [one.plugin for one, _ in drivers])

    def _why_not(self, robot: RobotConfig, drivers: Sequence[str]) -> Problem:
        """Return why there is no twin of a robot; the plugins `drivers` have one each."""
        if not robot.plugins:
            why = "the fleet file names no plugins, because the robot is served elsewhere"
            return Problem(str(self._config.source), 0, 0, f"robots.{robot.name}", f"{_CANNOT}: {why}")
        first = next(one for one in robot.plugins.values() if one.plugin not in self._keep)
        why = (
            f"{' and '.join(drivers)} each have a twin, and a robot has one body"
            if drivers
            else f"no twin is declared for {_join(one.plugin for one in robot.plugins.values())}; plugins with a twin: "
            f"{', '.join(self._twins)}"
        )
        return first.problem((), f"{_CANNOT}: {why}")

    def _observes_world(self, plugin: PluginSettings) -> bool:
        """Return whether a plugin has a part, such as one of its cameras, in the simulated world."""
        parts = [value for value in plugin.settings.values() if not isinstance(value, str)]
        return names_world(parts, self._manifests)

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


def _describe(twin: TwinSection) -> str:
    settings = ", ".join(f"{key}: {value}" for key, value in twin.settings.items())
    return f"{twin.plugin} ({settings})" if settings else twin.plugin


def _settings(robot: str, driver: PluginSettings, twin: TwinSection, instance: str) -> PluginSettings:
    """Return the twin's settings; problems with them point to the driver's settings."""
    mark = driver.tree.root.mark
    root = MarkedDict(mark)
    for key, value in twin.settings.items():
        root.put(key, value, mark, mark)
    return PluginSettings(instance, twin.plugin, YamlTree(root, ("robots", robot, "plugins", driver.instance)))


def _join(names: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(names))
