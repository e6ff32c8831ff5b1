"""The model of fleet files, and the resolved fleet."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, ConfigDict, Field, NonNegativeInt, PositiveFloat, PositiveInt

from eal_actors.device.world import WorldModel
from eal_actors.kernel.errors import Problem
from eal_actors.kernel.lock_step import Rate
from eal_actors.kernel.strict_model import NAMES_ONLY, Name, NameTemplate, StrictModel, Version1
from eal_actors.kernel.yaml_tree import Mark, MarkedDict, YamlPath, YamlTree
from eal_actors.managers.network_model import (
    BEHIND_ROUTER,
    DEFAULT_NETWORK,
    IDENTITY_MARK,
    AddressText,
    EndpointText,
    NetworkConfig,
    NetworkSection,
    is_loopback,
    parse_endpoint,
)

MAX_ROBOTS_OF_ONE_ENTRY = 10_000

Restart = Literal["permanent", "transient", "temporary"]
Text = Annotated[str, Field(min_length=1)]
RECORD_ENDINGS: Final = (".csv", ".html", ".json", ".jsonl", ".mcap", ".png", ".tmp", ".yaml")
"""Of the files in the record of a run, among which each robot's folder lies."""


def _refuse_file_name(name: str) -> str:
    if name.endswith(RECORD_ENDINGS):
        raise ValueError(
            f"a robot's name must not end in {PurePosixPath(name).suffix}, as the files in a run's record do"
        )
    return name


RobotTemplate = Annotated[NameTemplate, AfterValidator(_refuse_file_name)]
"""The name of a robot, or of many, with `{n}` for their number."""
MarkerTemplate = Annotated[str, Field(pattern=r"^([0-9]+|\{n\})$")]
ODOMETRY: Final = "odometry"
"""The source of a pose estimate that every robot with a base has."""
StepText = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_.]*:[A-Za-z_][A-Za-z0-9_]*$")]


class ClockSection(StrictModel):
    """How fast the fleet's time runs."""

    rate: PositiveFloat | Literal["max"] = 1.0
    """Seconds of fleet time in one real second; `max` is as fast as the machine goes, and repeatable."""


class PluginSection(StrictModel):
    """A plugin instance of a robot; all keys but `plugin` are the plugin's own settings."""

    model_config = ConfigDict(extra="allow")

    plugin: Text | None = None
    """The plugin's name, where it is not the name of the instance."""


class PoseStart(StrictModel):
    """A pose in the map frame."""

    x_m: float
    y_m: float
    yaw_deg: float = Field(default=0.0, ge=-360, le=360)


class PoseSection(StrictModel):
    """Where a robot's pose estimate comes from."""

    sources: tuple[Text, ...] = Field(default=(ODOMETRY,), alias="from", strict=False)
    """`odometry`, and the robots of the fleet whose resource Fixes sees this robot's marker."""
    marker: NonNegativeInt | MarkerTemplate | None = None
    """The number of the marker on the robot; `{n}` in numbered robots."""
    start: PoseStart | None = None
    """Where the odometry begins. Default: the start of a simulated robot; else unknown until the first fix, or
    (0, 0, 0) without trackers."""

    @property
    def trackers(self) -> tuple[str, ...]:
        """The sources that are robots."""
        return tuple(name for name in self.sources if name != ODOMETRY)


class Level(StrictModel):
    """The keys of defaults, types and robots. A level replaces the keys of the levels below it."""

    tags: tuple[Text, ...] = Field(default=(), strict=False)
    """Words to select robots by. As every list, tags replace those of lower levels."""
    timeout_s: PositiveFloat = 10.0
    """Deadline of a call that gives none, in seconds of the fleet's clock."""
    mailbox: PositiveInt = 256
    """How many calls may wait in an actor's mailbox."""
    restart: Restart = "permanent"
    """When an actor that ended is started again: always, after a crash, or never."""
    max_restarts: NonNegativeInt = 3
    """Restarts within `restart_window_s` after which the robot has failed."""
    restart_window_s: PositiveFloat = 5.0
    """In seconds of the fleet's clock."""
    exclusive: tuple[Text, ...] | None = Field(default=None, strict=False)
    """Resources that one controller at a time may command over the network; every actuator if left out."""
    pose: PoseSection = PoseSection()
    """Where the pose estimate comes from."""
    plugins: dict[Name, PluginSection] = Field(default={}, json_schema_extra=NAMES_ONLY)
    """Name of the instance to its settings."""


class TypeSection(Level):
    """A kind of robot."""

    type: Text | None = None
    """The type to build on."""


class RobotSection(TypeSection):
    """One robot, or several alike whose name holds `{n}`; `{n}` in its texts becomes the number as well."""

    count: int | None = Field(default=None, ge=1, le=MAX_ROBOTS_OF_ONE_ENTRY)
    """Make robots 1 to `count`."""
    range: tuple[NonNegativeInt, NonNegativeInt] | None = Field(default=None, strict=False)
    """Make robots from the first number to the last, both included."""
    address: AddressText | None = None
    """Where controllers reach the robot, such as `tcp/192.168.1.11:50000`, or `router` if it dials out to the network's
    routers; a robot without an address runs in the controller's process."""
    listen: EndpointText | None = None
    """Where the robot listens, if that is not its address, such as `tcp/0.0.0.0:50000`."""


def _require_hash(kept: str) -> str:
    if not re.fullmatch(r"scrypt:14:[\w-]{22}:[\w-]{43}|\*\*\*", kept):  # `***` in the copies beside runs
        raise ValueError("must be the hash that `eal keys operator` prints")
    return kept


OperatorRole = Literal["watch", "drive", "run", "administer"]


class OperatorSection(StrictModel):
    """A person who uses the dashboard; `eal keys operator` prints this section."""

    role: OperatorRole
    """Each role includes those before it: see the fleet; stop and command robots; run scenarios; change settings and
    reload the fleet file."""
    token: Annotated[str, AfterValidator(_require_hash)]
    """The hash of the operator's token. The token itself is in no file."""


class DashboardSection(StrictModel):
    """The users of `eal dashboard`."""

    operators: dict[Name, OperatorSection] = Field(default={}, json_schema_extra=NAMES_ONLY)
    """With operators, the page shows nothing without the token of one of them."""


class FleetFile(StrictModel):
    """A fleet file, or a part of one that other files include."""

    version: Version1
    name: Name | None = None
    """The fleet's name; the file's name without its ending if left out."""
    clock: ClockSection = ClockSection()
    seed: NonNegativeInt = 0
    """The seed of all random generators of the fleet."""
    world: Text | None = None
    """World file of the simulated robots, relative to this file, or the name of one that comes with the framework."""
    map: Text | None = None
    """Map file of map_server or Nav2, relative to this file: paths are planned on it instead of the world."""
    plugin_dirs: tuple[Text, ...] = Field(default=(), strict=False)
    """Folders of plugins, relative to this file; the bundled plugins are always found."""
    python_steps: tuple[StepText, ...] = Field(default=(), strict=False)
    """Functions for the `python` steps of scenarios besides installed steps, as `module:function`. The modules are
    beside this file, or on Python's path."""
    include: tuple[Text, ...] = Field(default=(), strict=False)
    """Fleet files to build on, relative to this file, or names of those that come with the framework; later ones
    override earlier ones, and this file all of them."""
    network: NetworkSection = NetworkSection()
    dashboard: DashboardSection = DashboardSection()
    defaults: Level = Level()
    types: dict[Name, TypeSection] = Field(default={}, json_schema_extra=NAMES_ONLY)
    robots: dict[RobotTemplate, RobotSection] = Field(default={}, json_schema_extra=NAMES_ONLY)


@dataclass(frozen=True, slots=True)
class PluginSettings:
    """The settings of one plugin instance, which the plugin's own model has yet to check.

    `instance` is unique in its robot. `tree` has the settings with their places in the file; errors about no setting in
    particular point to where the plugin is named.
    """

    instance: str
    plugin: str
    tree: YamlTree

    @property
    def settings(self) -> Mapping[str, Any]:
        """The plugin's settings."""
        return self.tree.root

    def problem(self, path: YamlPath, message: str) -> Problem:
        """Return a problem with a setting; the empty path means the plugin itself."""
        return self.tree.problem(path, message)


@dataclass(frozen=True, slots=True)
class RobotConfig:
    """A robot, merged with its types and the defaults; its other fields are those of RobotSection.

    `types` are its type, the type that builds on, and so on. `plugins`, by name of the instance, may be empty for a
    robot with an address, whose server has them.
    """

    name: str
    type: str | None
    types: tuple[str, ...]
    tags: tuple[str, ...]
    timeout_s: float
    mailbox: int
    restart: Restart
    max_restarts: int
    restart_window_s: float
    plugins: dict[str, PluginSettings]
    address: str | None = None
    listen: str | None = None
    exclusive: tuple[str, ...] | None = None
    pose: PoseSection = field(default_factory=PoseSection)


@dataclass(frozen=True, slots=True)
class FleetConfig:
    """A fleet, checked and resolved; its other fields are those of FleetFile.

    Attributes:
        source: the file it was read from, as the user gave it.
        plugin_dirs: folders to search for plugins before the bundled ones, in this order.
        robots: by name, in the order of the file; never empty.
        content: the merged content of the file and its includes, as plain values.
        tree: the same content with its places in the files.
        operators: the users of the dashboard, by name; empty if it asks for no names.
        map_path: the map file on which paths are planned; None for the world's floor.
    """

    name: str
    source: Path
    rate: Rate
    seed: int
    world: WorldModel | None
    plugin_dirs: tuple[Path, ...]
    robots: dict[str, RobotConfig]
    network: NetworkConfig = DEFAULT_NETWORK
    content: Mapping[str, Any] = field(default_factory=dict)
    tree: YamlTree = field(default=YamlTree(MarkedDict(Mark("fleet", 0, 0))), compare=False, repr=False)
    python_steps: tuple[str, ...] = ()
    operators: Mapping[str, OperatorSection] = field(default_factory=dict)
    map_path: Path | None = None

    @property
    def network_name(self) -> str:
        """Its name in keys of the network: robots and controllers with another one do not hear each other."""
        identity = self.network.identity
        return self.name if identity is None else f"{self.name}{IDENTITY_MARK}{identity}"

    def needs_identity(self, robots: Iterable[str]) -> bool:
        """Return whether other machines reach one of these robots, and any fleet of this name commands them."""
        if self.network.identity is not None or self.network.security is not None:
            return False
        addressed = [robot for name in robots if (robot := self.robots[name]).address is not None]
        own = [robot.listen or robot.address or "" for robot in addressed if robot.address != BEHIND_ROUTER]
        relays = self.network.routers if len(own) < len(addressed) else ()
        return not all(is_loopback(parse_endpoint(endpoint).host) for endpoint in (*own, *relays))


def robot_config(name: str, merged: MarkedDict, types: tuple[str, ...]) -> RobotConfig:
    """Build a robot from its merged levels, which the models have accepted one by one."""
    section = RobotSection.model_validate(merged)
    plugins = {
        instance: _plugin_settings(name, instance, merged["plugins"], section.plugins[instance].plugin)
        for instance in section.plugins
    }
    copied = {field.name for field in fields(RobotConfig)} - {"name", "types", "plugins"}
    return RobotConfig(name=name, types=types, plugins=plugins, **{key: getattr(section, key) for key in copied})


def _plugin_settings(robot: str, instance: str, plugins: MarkedDict, plugin: str | None) -> PluginSettings:
    entry: MarkedDict = plugins[instance]
    named_at = plugins.key_marks[instance] if plugin is None else entry.value_marks["plugin"]
    settings = MarkedDict(named_at)
    for key, value, key_mark, value_mark in entry.marked_items():
        if key != "plugin":
            settings.put(key, value, key_mark, value_mark)
    return PluginSettings(instance, plugin or instance, YamlTree(settings, ("robots", robot, "plugins", instance)))
