"""RobotStarter: the plugins and network sessions of one fleet, and the actors that it starts with them."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from eal_actors.actors.robot_actor import RobotSpec, start_robot
from eal_actors.actors.robot_view import RobotConnection, RobotView
from eal_actors.actors.supervision import Restart
from eal_actors.device.plugin_context import FleetServices
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.lock_step import MAX
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.memory import limit_heaps
from eal_actors.kernel.processors import sharing_processor, take_turns
from eal_actors.managers.fleet_changes import FleetChanges
from eal_actors.managers.fleet_model import FleetConfig, RobotConfig
from eal_actors.managers.network_check import no_lock_step
from eal_actors.managers.plugins import EALPluginManager
from eal_actors.wire.rpc.client.controller import Controller
from eal_actors.wire.rpc.client.remote_robot import RemoteRobot
from eal_actors.wire.session import check_process


class RobotStarter:
    """Starts the robots of a fleet. Thread: one at a time."""

    def __init__(self, config: FleetConfig, clock: Clock) -> None:
        self.config = config
        self._clock = clock
        self._local = sum(robot.address is None for robot in config.robots.values())
        take_turns()
        self._plugins = EALPluginManager(config.plugin_dirs)
        makers = self._plugins.open_port, self._plugins.open_camera
        self.services = FleetServices(clock, config.seed, config.world, *makers)
        self.services.markers = _markers(config)
        self._started: dict[str, RobotConfig] = {}  # the latest configuration of each robot of this process
        self._controllers: dict[str, Controller] = {}  # by robot
        if any(robot.address is not None for robot in config.robots.values()):
            limit_heaps()

    def check(self, robots: Iterable[RobotConfig]) -> None:
        """Raise ConfigError if a plugin does not exist or refuses its settings, or the clock does not fit.

        Raises UnavailableError if a robot is in another process, which this one cannot reach since it is a fork.
        """
        problems: set[Problem] = set()
        for robot in robots:
            if robot.address is None:  # the plugins of the others are in other processes
                problems.update(self._plugins.check(robot)[0])
            elif self.config.rate == MAX:
                problems.add(self.config.tree.problem(("clock", "rate"), no_lock_step(robot.name)))
            else:
                check_process()
        if problems:
            raise ConfigError(problems)

    def check_changes(self, changes: FleetChanges, former: RobotStarter) -> None:
        """Raise ConfigError if `check` refuses a robot that a reload starts, or a plugin refuses its change."""
        robots = [self.config.robots[name] for name in (*changes.added, *changes.restarted)]
        self.check(robots)
        problems: list[Problem] = []
        for robot in robots:
            if robot.address is None and (before := former._started.get(robot.name)) is not None:
                problems += self._plugins.check_change(before, robot)
        if problems:
            raise ConfigError(problems)

    def take_over(self, former: RobotStarter) -> None:
        """Continue with the shared objects and the sessions of the fleet's former starter."""
        self.services, self._started, self._controllers = former.services, former._started, former._controllers
        self.services.open_port, self.services.open_camera = self._plugins.open_port, self._plugins.open_camera
        self.services.markers = _markers(self.config)

    def start(self, robot: RobotConfig) -> tuple[RobotConnection, RobotView]:
        """Start a robot's actor. Does not block."""
        if robot.address is not None:
            return self._start_remote(robot, robot.address)
        self._started[robot.name] = robot
        spec = RobotSpec(
            name=robot.name,
            clock=self._clock,
            open_plugins=partial(self._plugins.connect, robot, self.services),
            timeout_s=robot.timeout_s,
            mailbox=robot.mailbox,
            restart=Restart(robot.restart),
            max_restarts=robot.max_restarts,
            restart_window_s=robot.restart_window_s,
            link=self.services.link(robot.name),
        )
        with sharing_processor(self._local):
            return start_robot(spec)

    def _start_remote(self, robot: RobotConfig, address: str) -> tuple[RobotConnection, RobotView]:
        if robot.name not in self._controllers:  # the endpoints of a session are fixed, so a reload opens another one
            remote = [one.name for one in self.config.robots.values() if one.address is not None]
            names = [name for name in remote if name not in self._controllers]
            self._controllers |= dict.fromkeys(names, Controller(self.config, self._clock, names).launch())
        view = RobotView(robot.name, self._clock)
        link = self.services.link(robot.name)
        return RemoteRobot(robot, address, link, view, self._controllers[robot.name]).launch(), view

    def end_sessions(self, timeout_s: float, robots: Iterable[str] | None = None) -> None:
        """Close the network sessions that only some robots used, which are closed; all sessions if None.

        Each has `timeout_s` real seconds to close. Thread: blocks the caller.
        """
        names = list(self._controllers) if robots is None else robots
        ended = {self._controllers.pop(name) for name in names if name in self._controllers}
        for controller in ended.difference(self._controllers.values()):
            controller.shut_down()
            if not controller.join(timeout_s):
                get_logger(fleet=self.config.name).error("the network did not close in time and was abandoned")


def _markers(config: FleetConfig) -> dict[str, int]:
    """Return the ids of the markers on robots, by the robots' names."""
    return {name: int(robot.pose.marker) for name, robot in config.robots.items() if robot.pose.marker is not None}
