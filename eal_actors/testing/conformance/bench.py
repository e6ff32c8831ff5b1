"""The bench: a plugin in a fleet of its own, and a notebook for what is found wrong with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeVar

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.device.info import ResourceType
from eal_actors.device.world import WorldModel
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import DeadlineError, EALError, PluginError
from eal_actors.kernel.yaml_tree import Mark, MarkedDict, YamlTree
from eal_actors.managers.fleet_model import FleetConfig, PluginSettings, RobotConfig
from eal_actors.managers.manifest import PluginManifest, read_manifest
from eal_actors.testing.conformance.stand_in import StandIn, stand_in_for

T = TypeVar("T")

Resources = Mapping[str, ResourceHandle]
"""The resources of a robot on the bench, by name."""

ROBOTS: Final = ("first", "second")
"""The robots on the bench."""

_LOOK_S: Final = 0.02

_ARENA: Final = WorldModel(version=1, name="bench", size_m=(12.0, 8.0))


@dataclass(frozen=True)
class Place:
    """A robot on the bench.

    Attributes:
        robot: the robot.
        resources: its resources that the checks are shown.
    """

    robot: RobotHandle
    resources: Resources


@dataclass(frozen=True)
class Bench:
    """A plugin's folder, and how to set the plugin up.

    Attributes:
        folder: the plugin's folder.
        settings: what a fleet file would say under the plugin's name; see `settings_of`.
        timeout_s: deadline of each call.
        left_out: names of resources that the checks are not shown.
        ready_within_s: real seconds in which a device must be found and greeted: the longest pause between two tries
            to open a port, and a greeting.
    """

    folder: Path
    settings: YamlTree
    timeout_s: float = 5.0
    left_out: frozenset[str] = frozenset()
    ready_within_s: float = 15.0

    def manifest(self) -> PluginManifest:
        """Read the plugin's manifest, or raise ConfigError."""
        return read_manifest(self.folder)

    def config(self, settings: Sequence[YamlTree]) -> FleetConfig:
        """Return a fleet whose every robot has the plugin, alone, each set up in its own way."""
        return FleetConfig(
            name="bench",
            source=self.folder,
            rate=1.0,
            seed=0,
            world=_ARENA,
            plugin_dirs=(self.folder.resolve().parent,),
            robots={name: self._robot(name, tree) for name, tree in zip(ROBOTS, settings, strict=False)},
        )

    def _robot(self, name: str, settings: YamlTree) -> RobotConfig:
        plugin = self.manifest().name
        return RobotConfig(
            name=name,
            type=None,
            types=(),
            tags=(),
            timeout_s=self.timeout_s,
            mailbox=256,
            restart="temporary",  # so that a crash shows
            max_restarts=0,
            restart_window_s=5.0,
            plugins={plugin: PluginSettings(plugin, plugin, settings)},
        )

    @contextmanager
    def robot(self) -> Iterator[Resources]:
        """Connect one robot for the length of a `with` block, and hand out its resources by name.

        Raises:
            ConfigError: the manifest or the settings are wrong.
            PluginError: the plugin, or one of its resources, did not come up.

        Thread: blocks while the robot connects.
        """
        with self.robots(1) as (robot,):
            yield robot

    @contextmanager
    def robots(self, count: int) -> Iterator[tuple[Resources, ...]]:
        """Connect several robots, each with its own instance of the plugin and its own stand-in; see `robot`."""
        with ExitStack() as stack:
            stand_ins = [stack.enter_context(self.stand_in()) for _ in range(count)]
            places = stack.enter_context(self.connected(stand_ins))
            yield tuple(place.resources for place in places)

    @contextmanager
    def stand_in(self) -> Iterator[StandIn | None]:
        """Plug in an emulator of the plugin's device, if it has one and the settings name no device."""
        stand_in = stand_in_for(self.manifest(), self.settings.root)
        try:
            yield stand_in
        finally:
            if stand_in is not None:
                stand_in.close()

    @contextmanager
    def connected(self, stand_ins: Sequence[StandIn | None], *, ready: bool = True) -> Iterator[tuple[Place, ...]]:
        """Connect a robot for each stand-in, or for None; raises as `robot` does.

        Args:
            stand_ins: what each robot's device is.
            ready: wait until the devices can be used.
        """
        settings = [self.settings if one is None else settings_of(one.settings) for one in stand_ins]
        with Fleet(self.config(settings)) as fleet:
            robots = tuple(fleet.values())
            for robot in robots:
                _require_up(robot)
                if ready:
                    _require_ready(robot, self.ready_within_s)
            yield tuple(
                Place(robot, {name: handle for name, handle in robot.items() if name not in self.left_out})
                for robot in robots
            )


def _require_up(robot: RobotHandle) -> None:
    if robot.problems:
        raise PluginError("; ".join(dict.fromkeys(problem.message for problem in robot.problems)))
    robot.wait_started(0.0)
    for name, handle in robot.items():
        try:
            handle.info  # noqa: B018  # reading it tells whether the resource has come up
        except EALError as error:
            raise PluginError(f"{name} did not come up: {error.message}") from error


def comes_true(holds: Callable[[], bool], within_s: float) -> bool:
    """Look again and again, in real seconds, because hardware does not tell. Thread: blocks the caller."""
    end_s = REAL_TIME.now() + within_s
    while not (found := holds()) and REAL_TIME.now() < end_s:
        REAL_TIME.sleep(_LOOK_S)
    return found


def _require_ready(robot: RobotHandle, within_s: float) -> None:
    if not comes_true(lambda: not robot.not_ready, within_s):
        raise PluginError("; ".join(f"{name} is not ready: {reason}" for name, reason in robot.not_ready.items()))


def settings_of(settings: Mapping[str, Any]) -> YamlTree:
    """Return settings as if a file said so, in which problems are named `settings`."""
    mark = Mark("settings", 0, 0)
    root = MarkedDict(mark)
    for key, value in settings.items():
        root.put(key, value, mark, mark)
    return YamlTree(root)


@dataclass
class Findings:
    """What a check found.

    Attributes:
        problems: what is wrong, each with the resource's name.
        tried: how much was looked at; a check that found nothing to look at was skipped.
    """

    problems: list[str] = field(default_factory=list)
    tried: int = 0

    def expect(self, *, holds: bool, problem: str) -> bool:
        """Note a problem unless something holds; returns whether it does."""
        self.tried += 1
        if not holds:
            self.problems.append(problem)
        return holds

    def answer(self, future: Future[T]) -> T | None:
        """Wait for a call that must succeed; returns None, and notes why, if it does not."""
        self.tried += 1
        try:
            return future.get()
        except EALError as error:
            self.problems.append(f"{future.describe().partition('/')[2]} failed: {error.code}: {error.message}")
            return None

    def refusal(self, future: Future[Any], wanted: type[EALError]) -> EALError | None:
        """Wait for a call that must fail with a certain error; returns that error."""
        self.tried += 1
        what = future.describe().partition("/")[2]
        error = future.exception()
        if isinstance(error, wanted):
            return error
        outcome = (
            "succeeded" if error is None else f"failed with {type(error).__name__}: {getattr(error, 'message', error)}"
        )
        self.problems.append(f"{what} must fail with {wanted.__name__}, but {outcome}")
        return None


class BlockedActor(Exception):  # noqa: N818  # it ends a check, and never leaves the runner
    """A resource is stuck in a command, so that nothing more can be found out about it.

    Attributes:
        resource: its name.
    """

    def __init__(self, resource: str, what: str) -> None:
        super().__init__(f"`{what}` blocked its actor: make it a generator and yield the seconds instead of sleeping")
        self.resource = resource


def settle(handle: ResourceHandle, what: str) -> None:
    """Wait until the resource has begun with what was sent to it before.

    Args:
        handle: the resource.
        what: the command that was sent, for people.

    Raises:
        BlockedActor: it is stuck in that.

    Thread: blocks the caller.
    """
    error = handle.get_config("eal-conformance-settle").exception()  # refused, but only when its turn has come
    if isinstance(error, DeadlineError):
        raise BlockedActor(handle.name, what)


def actuators(robot: Resources) -> list[ResourceHandle]:
    """Return the robot's actuators."""
    return [handle for handle in robot.values() if ResourceType.ACTUATOR in handle.info.types]
