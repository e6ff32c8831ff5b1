"""The configuration of a fleet, read from files and checked before anything starts."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from eal_actors.device.world import WorldModel
from eal_actors.device.world.loading import validate
from eal_actors.kernel.errors import ConfigError, Problem, RobotNotFoundError
from eal_actors.kernel.strict_model import model_of, schema_of
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.managers.fleet_loader import fleet_of, load_fleet, load_valid_part
from eal_actors.managers.fleet_model import FleetConfig, FleetFile, RobotConfig
from eal_actors.managers.manifest import ManifestFile
from eal_actors.managers.memory_file import tree_of

T = TypeVar("T")


class EALConfigManager:
    """Reads the configuration of a fleet for all other parts.

    Source: thesis §4.3.1 gives the manager this purpose, but leaves it an interface that returns hard-coded values. Its
    changes are adopted by `Fleet.reload`.
    """

    def __init__(self, fleet: FleetConfig) -> None:
        self.fleet = fleet

    @classmethod
    def load(cls, path: str | Path, *, environment: Mapping[str, str] | None = None) -> EALConfigManager:
        """Read a fleet file and what it refers to.

        Without an environment, `${NAME}` in fleet files has the values of the process's environment. Raises ConfigError
        with every problem of all the files.
        """
        return cls(load_fleet(path, os.environ if environment is None else environment))

    @staticmethod
    def load_valid_part(path: str | Path) -> FleetConfig | None:
        """Read an invalid fleet file without its invalid values, only for more checks; None if that is not possible."""
        return load_valid_part(path, os.environ)

    @classmethod
    def of(
        cls, content: Mapping[str, object], *, name: str = "fleet", environment: Mapping[str, str] | None = None
    ) -> EALConfigManager:
        """Read a fleet from memory, with the checks of a file.

        Args:
            content: the content of a fleet file. Tuples may stand for lists, and paths for text; paths in it are
                relative to the working directory, and `${NAME}` is not replaced.
            name: its name in problems, and the fleet's name if the content has none.
            environment: values of `${NAME}` in included files; the process's environment if None.

        Raises ConfigError with every problem of the content and of the files it refers to.
        """
        return cls(fleet_of(content, name, os.environ if environment is None else environment))

    def robot(self, name: str) -> RobotConfig:
        """Return a robot by name. Raises RobotNotFoundError if the fleet has no robot of that name."""
        self._require("robot", [name], self.fleet.robots)
        return self.fleet.robots[name]

    def select(
        self, names: Iterable[str] | None = None, tags: Iterable[str] | None = None, types: Iterable[str] | None = None
    ) -> tuple[RobotConfig, ...]:
        """Return the robots that match, in the order of the fleet.

        Without arguments all robots match. A type matches those that build on it too. The list may be empty if each of
        the names, tags and types exists, but not together. Raises RobotNotFoundError if no robot of the fleet has one
        of the names, tags or types.
        """
        robots = chosen = list(self.fleet.robots.values())
        if names is not None:
            wanted = self._require("robot", names, self.fleet.robots)
            chosen = [robot for robot in chosen if robot.name in wanted]
        if tags is not None:
            wanted = self._require("tag", tags, (tag for robot in robots for tag in robot.tags))
            chosen = [robot for robot in chosen if wanted.intersection(robot.tags)]
        if types is not None:
            wanted = self._require("type", types, (name for robot in robots for name in robot.types))
            chosen = [robot for robot in chosen if wanted.intersection(robot.types)]
        return tuple(chosen)

    def _require(self, what: str, wanted: Iterable[str], known: Iterable[str]) -> set[str]:
        asked, existing = {wanted} if isinstance(wanted, str) else set(wanted), set(known)  # one name, not its letters
        for name in sorted(asked - existing):
            owner = f"the fleet '{self.fleet.name}' has no robot"
            message = f"{owner} '{name}'" if what == "robot" else f"{owner} of {what} '{name}'"
            raise RobotNotFoundError(message + did_you_mean(name, existing))
        return asked


def collect_problems(problems: list[Problem], read: Callable[[], T]) -> T | None:
    """Return what `read` returns; add the problems of its ConfigError and return None if it fails."""
    try:
        return read()
    except ConfigError as error:
        problems += error.problems
        return None


def world_of(content: WorldModel | Mapping[str, object], *, name: str = "world") -> WorldModel:
    """Read a world from memory, with the checks of a file.

    `content` is that of a world file, or a model made in Python, which is checked as a whole. `name` is its name in
    problems. Raises ConfigError with every problem of the content.
    """
    tree = tree_of({} if isinstance(content, WorldModel) else content, name)
    world = content if isinstance(content, WorldModel) else model_of(WorldModel, tree)
    if problems := [tree.problem(path, message) for path, message in validate(world)]:
        raise ConfigError(problems)
    return world


def manifest_schema() -> dict[str, Any]:
    """Return the JSON Schema of plugin manifests."""
    return schema_of(ManifestFile)


def fleet_schema() -> dict[str, Any]:
    """Return the JSON Schema of fleet files, for editors."""
    return schema_of(FleetFile)


def world_schema() -> dict[str, Any]:
    """Return the JSON Schema of world files."""
    return schema_of(WorldModel)
