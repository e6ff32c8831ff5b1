"""Test bench for a plugin: a fleet of its own, and the record of findings."""

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
from eal_actors.facade.fleet import START_TIMEOUT_S, Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import DeadlineError, EALError, PluginError
from eal_actors.kernel.yaml_tree import YamlTree
from eal_actors.managers.fleet_model import FleetConfig, PluginSettings, RobotConfig
from eal_actors.managers.manifest import PluginManifest, read_manifest
from eal_actors.managers.memory_file import tree_of
from eal_actors.testing.conformance.emulated_device import EmulatedDevice, emulate_device

T = TypeVar("T")

Resources = Mapping[str, ResourceHandle]
"""Resources of a robot on the bench, by name."""

ROBOTS: Final = ("first", "second")
"""The names of the robots on the bench."""

_POLL_S: Final = 0.02

_ARENA: Final = WorldModel(version=1, name="bench", size_m=(12.0, 8.0))


@dataclass(frozen=True)
class BenchRobot:
    """A robot on the bench, with the resources to check."""

    robot: RobotHandle
    resources: Resources


@dataclass(frozen=True)
class Bench:
    """A plugin's folder, with settings for the plugin.

    Attributes:
        settings: the plugin's settings, as in a fleet file; see `settings_of`.
        left_out: names of resources that are not checked.
        ready_within_s: real seconds until a device must be ready: the longest pause between two attempts to open a
            port, and the handshake.
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
        """Return a fleet of robots that have only this plugin, each with its own settings."""
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
        """Connect one robot during the `with` block, and yield its resources by name.

        Raises:
            ConfigError: the manifest or the settings are wrong.
            PluginError: the plugin, or one of its resources, did not start.

        Thread: blocks while the robot connects.
        """
        with self.robots(1) as (robot,):
            yield robot

    @contextmanager
    def robots(self, count: int) -> Iterator[tuple[Resources, ...]]:
        """Connect several robots like `robot`, each with its own instance and its own emulated device."""
        with ExitStack() as stack:
            devices = [stack.enter_context(self.emulated_device()) for _ in range(count)]
            robots = stack.enter_context(self.connected(devices))
            yield tuple(robot.resources for robot in robots)

    @contextmanager
    def emulated_device(self) -> Iterator[EmulatedDevice | None]:
        """Connect an emulator of the plugin's device, if it has one and the settings name no device."""
        device = emulate_device(self.manifest(), self.settings.root)
        try:
            yield device
        finally:
            if device is not None:
                device.wire.close()

    @contextmanager
    def connected(
        self, devices: Sequence[EmulatedDevice | None], *, ready: bool = True
    ) -> Iterator[tuple[BenchRobot, ...]]:
        """Connect a robot for each emulated device, or for None; wait for the devices if asked; as `robot`."""
        settings = [self.settings if one is None else settings_of(one.settings) for one in devices]
        with Fleet(self.config(settings)) as fleet:
            robots = tuple(fleet.values())
            for robot in robots:
                _require_up(robot)
                if ready:
                    _require_ready(robot, self.ready_within_s)
            yield tuple(
                BenchRobot(robot, {name: handle for name, handle in robot.items() if name not in self.left_out})
                for robot in robots
            )


def _require_up(robot: RobotHandle) -> None:
    if robot.problems:
        messages = dict.fromkeys(problem.message for problem in robot.problems)
        repeating = {one for one in messages for other in messages if one != other and other in one}
        raise PluginError("; ".join(message for message in messages if message not in repeating))
    robot.wait_started(0.0, START_TIMEOUT_S)  # the fleet has waited
    for name, handle in robot.items():
        try:
            handle.info  # noqa: B018  # reading it fails if the resource has not started
        except EALError as error:
            raise PluginError(f"{name} did not start: {error.message}") from error


def wait_until(holds: Callable[[], bool], within_s: float) -> bool:
    """Poll a condition in real time (hardware sends no events); return whether it holds. Thread: blocks the caller."""
    end_s = REAL_TIME.now() + within_s
    while not (found := holds()) and REAL_TIME.now() < end_s:
        REAL_TIME.sleep(_POLL_S)
    return found


def _require_ready(robot: RobotHandle, within_s: float) -> None:
    if not wait_until(lambda: not robot.not_ready, within_s):
        raise PluginError("; ".join(f"{name} is not ready: {reason}" for name, reason in robot.not_ready.items()))


def settings_of(settings: Mapping[str, Any]) -> YamlTree:
    """Return settings as from a file; problems refer to it as `settings`."""
    return tree_of(settings, "settings")


@dataclass
class Findings:
    """Findings of a check. `tried` counts what was checked; a check with none counts as skipped."""

    problems: list[str] = field(default_factory=list)
    tried: int = 0

    def expect(self, holds: bool, problem: str) -> bool:
        """Record a problem unless a condition holds; return the condition."""
        self.tried += 1
        if not holds:
            self.problems.append(problem)
        return holds

    def answer(self, future: Future[T]) -> T | None:
        """Return the answer of a call that must succeed; record a problem and return None if it fails."""
        self.tried += 1
        try:
            return future.get()
        except EALError as error:
            self.problems.append(f"{future.describe().partition('/')[2]} failed: {error.code}: {error.message}")
            return None

    def refusal(self, future: Future[Any], wanted: type[EALError]) -> EALError | None:
        """Return the error of a call that must fail with it; record a problem and return None otherwise."""
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


class BlockedActor(Exception):  # noqa: N818  # ends a check, and never leaves the runner
    """A command blocks a resource's actor, so that the resource cannot be checked further."""

    def __init__(self, resource: str, what: str) -> None:
        super().__init__(f"`{what}` blocked its actor: make it a generator and yield the seconds instead of sleeping")
        self.resource = resource


def wait_until_started(handle: ResourceHandle, what: str) -> None:
    """Wait until the resource has started the previous command, named `what` in messages.

    Raises BlockedActor if the command blocks the actor.

    Thread: blocks the caller.
    """
    error = handle.get_config("eal-conformance-settle").exception()  # refused after the previous command has started
    if isinstance(error, DeadlineError):
        raise BlockedActor(handle.name, what)


def actuators(robot: Resources) -> list[ResourceHandle]:
    """Return the robot's actuators."""
    return [handle for handle in robot.values() if ResourceType.ACTUATOR in handle.info.types]
