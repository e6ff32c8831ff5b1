"""RobotService: a robot of a fleet file that runs in this process and serves the network."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import replace
from types import TracebackType
from typing import Final, Self

from eal_actors.actors.handles import RobotHandle
from eal_actors.device.info import unknown_name
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError, EALError, Problem
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.network_model import BEHIND_ROUTER
from eal_actors.net.server.host import RobotHost
from eal_actors.net.server.robot_server import RobotServer
from eal_actors.net.session import endpoints_of, robot_config
from eal_actors.net.session_keeper import SessionKeeper

_CLOSE_S: Final = 1.5
"""Real seconds for each step of closing."""


class RobotService:
    """A robot that runs in this process and serves its resources on the network, for a `with` block.

    Args:
        config: the fleet.
        robot: the robot's name.

    Attributes:
        endpoints: the endpoints that it listens on, or of the routers that it connects to.
        is_behind_router: whether it connects to routers.
        dead_man_trips: how often each resource was halted because its controller was silent.

    Raises:
        RobotNotFoundError: the fleet has no such robot.
        ConfigError: the robot has no address, or no plugins.
    """

    def __init__(self, config: FleetConfig, robot: str) -> None:
        (wanted,) = EALConfigManager(config).select([robot])
        problem = ""
        if wanted.address is None:
            problem = "has no address, so it cannot be reached; give it one, such as tcp/0.0.0.0:50000"
        elif not wanted.plugins:
            problem = "has no plugins here, so it has nothing to serve; give it one under 'plugins'"
        if problem:
            raise ConfigError([Problem(str(config.source), 0, 0, f"robots.{robot}", f"robot {robot!r} {problem}")])
        self._config = config
        self._name = robot
        self._exclusive = wanted.exclusive
        self.endpoints: Final = endpoints_of(robot_config(config, robot))
        self.is_behind_router: Final = wanted.address == BEHIND_ROUTER
        self._fleet = Fleet(replace(config, robots={robot: replace(wanted, address=None, listen=None)}))
        self._server: RobotServer | None = None
        self._stack = ExitStack()
        self.dead_man_trips: Mapping[str, int] = {}

    @property
    def robot(self) -> RobotHandle:
        """The robot in this process."""
        return self._fleet[self._name]

    def open(self) -> Self:
        """Start the robot, then open the network, so that controllers find it ready.

        Raises:
            ConfigError: its plugins refuse their settings; or `exclusive` names an unknown resource.
            RobotFailedError: it could not start.
            UnavailableError: the port is in use, or no router answers.

        Thread: blocks the caller.
        """
        with ExitStack() as stack:
            stack.callback(self._fleet.close, _CLOSE_S)
            self._fleet.connect()
            self.robot.require_started()
            self._check_exclusive()
            keeper = SessionKeeper(self._name, self._config.network, lambda: robot_config(self._config, self._name))
            stack.callback(keeper.close)
            session = keeper.open()
            host = RobotHost(self._config.name, session, self._config.network, self._name).launch()
            stack.callback(host.close, _CLOSE_S)
            self._server = server = host.serve(self.robot, self._exclusive)
            self.dead_man_trips = server.dead_man_trips
            stack.callback(server.close)
            stack.callback(self._halt)
            keeper.follow(host.move_to)
            self._stack = stack.pop_all()
        return self

    def wait(self) -> None:
        """Wait until the server crashes.

        Raises:
            UnavailableError: the server has crashed; restart the process.
            RuntimeError: it is not open.

        Thread: blocks the caller.
        """
        if self._server is None:
            raise RuntimeError(f"the service of {self._name} is not open")
        self._server.wait()

    def _check_exclusive(self) -> None:
        source, path = str(self._config.source), f"robots.{self._name}.exclusive"
        unknown = [name for name in self._exclusive or () if name not in self.robot]
        problems = [Problem(source, 0, 0, path, unknown_name("resource", name, self.robot)) for name in unknown]
        if problems:
            raise ConfigError(problems)

    def _halt(self) -> None:
        """Stop all motion and refuse new motion, while controllers can still receive the outcome."""
        with suppress(EALError):
            self.robot.stop("its server is being stopped").get(timeout=self.robot.clock.of_real(_CLOSE_S / 3))

    def close(self) -> None:
        """Halt everything, leave the network and stop the robot. Closing it twice is harmless.

        Thread: blocks the caller, for a bounded time.
        """
        self._stack.close()

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()
