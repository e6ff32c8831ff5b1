"""The changes of a fleet between two readings of its file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from eal_actors.kernel.errors import ConfigError
from eal_actors.managers.fleet_model import FleetConfig, RobotConfig


@dataclass(frozen=True, slots=True)
class FleetChanges:
    """The names of the robots that a reload changes, in the order of the file.

    `restarted` are the others whose connection has changed: address, plugins, settings, start pose, mailbox, deadline,
    restarts. `relabelled` are the others whose tags or types have changed.
    """

    added: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()
    restarted: tuple[str, ...] = ()
    relabelled: tuple[str, ...] = ()

    def __str__(self) -> str:
        fields = {"added": self.added, "removed": self.removed, "restarted": self.restarted, "tags": self.relabelled}
        return "; ".join(f"{what} {', '.join(names)}" for what, names in fields.items() if names) or "nothing changed"


def changes_between(before: FleetConfig, after: FleetConfig) -> FleetChanges:
    """Return the changes from one configuration of an open fleet to another.

    Raises ConfigError if they change what all robots of the fleet share; each problem has its place in the new file.
    """
    why = "cannot change while the fleet is open; close the fleet and open it again"
    if fixed := _changed_for_all(before, after):
        raise ConfigError([after.tree.problem(path, f"'{'.'.join(path)}' {why}") for path in fixed])
    both = {name: (before.robots[name], robot) for name, robot in after.robots.items() if name in before.robots}
    restarted = tuple(name for name, (old, new) in both.items() if _connection(old) != _connection(new))
    return FleetChanges(
        added=tuple(name for name in after.robots if name not in both),
        removed=tuple(name for name in before.robots if name not in both),
        restarted=restarted,
        relabelled=tuple(
            name
            for name, (old, new) in both.items()
            if name not in restarted and (old.types, old.tags) != (new.types, new.tags)
        ),
    )


def _changed_for_all(before: FleetConfig, after: FleetConfig) -> list[tuple[str, ...]]:
    """Return the paths of the keys that have changed and that all robots of the fleet share."""
    is_networked = any(robot.address is not None for robot in before.robots.values())
    differs = {
        ("name",): before.name != after.name,
        ("clock", "rate"): _rate(before) != _rate(after),
        ("seed",): before.content.get("seed", 0) != after.content.get("seed", 0),
        ("world",): before.world != after.world,
        ("map",): before.map_path != after.map_path,
        ("network",): is_networked and before.network != after.network,
    }
    return [path for path, is_changed in differs.items() if is_changed]


def _rate(config: FleetConfig) -> object:
    """Return the rate in the file, which a program may have replaced."""
    return (config.content.get("clock") or {}).get("rate", 1.0)


def _connection(robot: RobotConfig) -> tuple[Any, ...]:
    """Return what the connection to a robot is made of; the server of a robot with an address has its plugins."""
    common = (robot.address, robot.timeout_s, robot.mailbox)
    if robot.address is not None:
        return common
    plugins = [(one.instance, one.plugin, one.settings) for one in robot.plugins.values()]
    return (*common, plugins, robot.pose.start, robot.restart, robot.max_restarts, robot.restart_window_s)
