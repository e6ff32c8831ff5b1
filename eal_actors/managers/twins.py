"""Makes of any fleet one that is simulated as a whole, so that nothing real can move."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final

from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.lock_step import MAX
from eal_actors.kernel.yaml_tree import MarkedDict, YamlTree
from eal_actors.managers.fleet_model import FleetConfig, PluginSettings, RobotConfig

SIM: Final = "sim"
_PORT: Final = f"{SIM}://world"
TWINS: Final[Mapping[str, str]] = {
    "evbot2": "evbot2",
    "evbot3": "evbot3",
    "mote_roomba": "roomba",
    "roomba_oi": "roomba",
}
"""Which model of the simulation stands in for the robot that a driver drives."""


@dataclass(frozen=True, slots=True)
class Simulated:
    """A fleet of which every robot is simulated.

    Attributes:
        config: the fleet; its clock goes as fast as the machine.
        stand_ins: why a robot is another than the file says, by its name.
        left_out: why a robot, or a plugin of a robot, is not there, by name.
        bodies: by robot, the name of its body in the world.
    """

    config: FleetConfig
    stand_ins: Mapping[str, str]
    left_out: Mapping[str, str]
    bodies: Mapping[str, str]


def simulated(config: FleetConfig, needed: Iterable[str], keep: Collection[str] = ()) -> Simulated:
    """Return a fleet without anything real.

    A robot of the simulation, or a driver on a simulated port, stays as it is; what else such a robot has is left out.
    The robot of a driver is replaced by the simulation's model of it. Robots with an address become local.

    Args:
        config: any fleet.
        needed: the robots that must be there; others that cannot be simulated are left out.
        keep: plugins that move nothing real, and run as they are.

    Raises:
        ConfigError: a robot that is needed cannot be simulated.
    """
    maker = _Maker(config, frozenset(keep))
    required = frozenset(needed)
    robots: dict[str, RobotConfig] = {}
    problems: list[Problem] = []
    for name, robot in config.robots.items():
        made = maker.make(robot)
        if isinstance(made, RobotConfig):
            robots[name] = made
        elif name in required:
            problems.append(made)
        else:
            maker.left_out[name] = made.message
    if problems:
        raise ConfigError(problems)
    fleet = replace(config, robots=robots, rate=MAX)
    return Simulated(fleet, maker.stand_ins, maker.left_out, maker.bodies)


class _Maker:
    """Makes the simulated robots of one fleet."""

    def __init__(self, config: FleetConfig, keep: frozenset[str]) -> None:
        self.stand_ins: dict[str, str] = {}
        self.left_out: dict[str, str] = {}
        self.bodies: dict[str, str] = {}
        self._config = config
        self._keep = keep

    def make(self, robot: RobotConfig) -> RobotConfig | Problem:
        """Return the robot as it can be simulated, or why it cannot be."""
        local = replace(robot, address=None, listen=None)
        kept = {name: one for name, one in robot.plugins.items() if one.plugin in self._keep}
        bodies = {name: one for name, one in robot.plugins.items() if _body_of(robot, one) is not None}
        if not bodies:
            return self._twin(local, kept)
        self._note_dropped(robot, {**kept, **bodies})
        self.bodies[robot.name] = next(body for one in bodies.values() if (body := _body_of(robot, one)))
        return replace(local, plugins={name: one for name, one in robot.plugins.items() if name in {**kept, **bodies}})

    def _twin(self, robot: RobotConfig, kept: Mapping[str, PluginSettings]) -> RobotConfig | Problem:
        drivers = [one for one in robot.plugins.values() if one.plugin in TWINS]
        if len(drivers) == 1:
            driver = drivers[0]
            self.stand_ins[robot.name] = f"the simulation's {TWINS[driver.plugin]} stands in for {driver.plugin}"
            self.bodies[robot.name] = robot.name
            return replace(robot, plugins={SIM: _settings(robot.name, driver), **kept})
        if kept and len(kept) == len(robot.plugins):
            return robot
        if not robot.plugins:
            why = "the fleet file does not say what it is made of, for it is served elsewhere"
            return Problem(str(self._config.source), 0, 0, f"robots.{robot.name}", f"{_CANNOT}: {why}")
        first = next(one for one in robot.plugins.values() if one.plugin not in self._keep)
        why = (
            f"the simulation has models for {' and '.join(one.plugin for one in drivers)}, and a robot has one body"
            if drivers
            else f"it has no model for {_listed(one.plugin for one in robot.plugins.values())}; there are models for "
            f"{', '.join(TWINS)}"
        )
        return first.problem((), f"{_CANNOT}: {why}")

    def _note_dropped(self, robot: RobotConfig, stays: Collection[str]) -> None:
        dropped = [one.plugin for name, one in robot.plugins.items() if name not in stays]
        if dropped:
            self.left_out[robot.name] = f"its plugins that are not simulated: {_listed(dropped)}"


_CANNOT: Final = "cannot be simulated"


def _body_of(robot: RobotConfig, plugin: PluginSettings) -> str | None:
    """Return the name of the body that a plugin drives in the simulated world; None if it is not of that world."""
    if plugin.plugin == SIM:
        return robot.name
    ports = [value for value in plugin.settings.values() if isinstance(value, str) and value.startswith(_PORT)]
    return ports[0].removeprefix(_PORT).strip("/") or robot.name if ports else None


def _settings(robot: str, driver: PluginSettings) -> PluginSettings:
    """Return the settings of the simulation's plugin, which stand where those of the driver do."""
    mark = driver.tree.root.mark
    root = MarkedDict(mark)
    root.put("model", TWINS[driver.plugin], mark, mark)
    return PluginSettings(SIM, SIM, YamlTree(root, ("robots", robot, "plugins", driver.instance)))


def _listed(names: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(names))
