"""RobotService: a robot of a fleet file, run in this process and offered to the network."""

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
from eal_actors.net.session import endpoints_of, open_session, robot_config

_CLOSE_S: Final = 1.5
"""Real seconds that each part of the end may take."""


class RobotService:
    """Runs one robot of a fleet and serves its resources, for the length of a `with` block.

    Args:
        config: the fleet.
        robot: the robot's name.

    Attributes:
        endpoints: where it listens, or which routers it dials out to.
        is_behind_router: whether it dials out.
        dead_man_trips: how often each resource was halted because its controller was silent.

    Raises:
        RobotNotFoundError: the fleet has no such robot.
        ConfigError: the robot has no address, or no plugins.
    """

    def __init__(self, config: FleetConfig, robot: str) -> None:
        (wanted,) = EALConfigManager(config).select([robot])
        if wanted.address is None:
            message = f"robot {robot!r} has no address, so nobody can reach it; give it one, such as tcp/0.0.0.0:50000"
            raise ConfigError([Problem(str(config.source), 0, 0, f"robots.{robot}", message)])
        if not wanted.plugins:
            message = f"robot {robot!r} has no plugins here, so there is nothing to serve; give it one under 'plugins'"
            raise ConfigError([Problem(str(config.source), 0, 0, f"robots.{robot}", message)])
        self._config = config
        self._name = robot
        self._exclusive = wanted.exclusive
        self._network = robot_config(config, robot)
        self.endpoints: Final = endpoints_of(self._network)
        self.is_behind_router: Final = wanted.address == BEHIND_ROUTER
        self._fleet = Fleet(replace(config, robots={robot: replace(wanted, address=None, listen=None)}))
        self._server: RobotServer | None = None
        self._stack = ExitStack()
        self.dead_man_trips: Mapping[str, int] = {}

    @property
    def robot(self) -> RobotHandle:
        """The robot as this process sees it."""
        return self._fleet[self._name]

    def open(self) -> Self:
        """Start the robot, then open the network: whoever finds it finds it ready.

        Raises:
            ConfigError: what its plugins refuse; or `exclusive` names no resource of it.
            RobotFailedError: it could not start.
            UnavailableError: the port is in use, or no router answers.

        Thread: blocks the caller.
        """
        with ExitStack() as stack:
            stack.callback(self._fleet.close, _CLOSE_S)
            self._fleet.connect()
            self.robot.require_started()
            self._check_exclusive()
            session = stack.enter_context(open_session(self._network))
            host = RobotHost(self._config.name, session, self._config.network, self._name).launch()
            stack.callback(host.close, _CLOSE_S)
            self._server = server = host.serve(self.robot, self._exclusive)
            self.dead_man_trips = server.dead_man_trips
            stack.callback(server.close)
            stack.callback(self._halt)
            self._stack = stack.pop_all()
        return self

    def wait(self) -> None:
        """Wait, which takes for ever, unless the service breaks down.

        Raises:
            UnavailableError: its server has crashed, so that whoever looks after this process is to start it anew.
            RuntimeError: it is not open.

        Thread: blocks the caller.
        """
        if self._server is None:
            raise RuntimeError(f"the service of {self._name} is not open")
        self._server.wait()

    def _check_exclusive(self) -> None:
        problems = [
            Problem(
                str(self._config.source),
                0,
                0,
                f"robots.{self._name}.exclusive",
                unknown_name("resource", name, self.robot),
            )
            for name in self._exclusive or ()
            if name not in self.robot
        ]
        if problems:
            raise ConfigError(problems)

    def _halt(self) -> None:
        """Stop what moves while whoever moves it can still be told, and let nothing begin any more."""
        with suppress(EALError):
            self.robot.stop("its server is being stopped").get(timeout=self.robot.clock.of_real(_CLOSE_S / 3))

    def close(self) -> None:
        """Take leave of the network, halt everything and stop the robot. Calling it twice is harmless.

        Thread: blocks the caller, for a bounded time.
        """
        self._stack.close()

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()
