"""RobotService: a robot of a fleet file that runs in this process and serves the network."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from typing import Final, Self

from eal_actors.actors.handles import RobotHandle
from eal_actors.device.info import unknown_name
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError, EALError, Problem, UnsupportedError, file_error
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.memory import limit_heaps
from eal_actors.kernel.processors import sharing_processor, take_turns
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_changes import FleetChanges
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.network_model import BEHIND_ROUTER
from eal_actors.wire.listening import require_free
from eal_actors.wire.rpc.server.host import RobotHost
from eal_actors.wire.rpc.server.robot_server import RobotServer
from eal_actors.wire.session import endpoints_of, listening_at, robot_config
from eal_actors.wire.session_keeper import SessionKeeper

_CLOSE_S: Final = 1.5  # real seconds for each step of closing


class RobotService:
    """A robot that runs in this process and serves its resources on the network, for a `with` block.

    Args:
        shared: a connected fleet of this process that has the robot, and that is not closed here; None for a fleet of
            the robot alone. See `serve_together`.
        host: receives its calls, and is not closed here; None for a session and a host of its own.

    Attributes:
        endpoints: the endpoints that it listens on, or of the routers that it connects to.
        dead_man_trips: how often each resource was halted because its controller was silent.

    Raises:
        RobotNotFoundError: the fleet has no such robot.
        ConfigError: the robot has no address, or no plugins.
    """

    def __init__(
        self, config: FleetConfig, robot: str, shared: Fleet | None = None, host: RobotHost | None = None
    ) -> None:
        (wanted,) = EALConfigManager(config).select([robot])
        problem = ""
        if wanted.address is None:
            problem = "has no address, so it cannot be reached; give it one, such as tcp/0.0.0.0:50000"
        elif not wanted.plugins:
            problem = "has no plugins here, so it has nothing to serve; give it one under 'plugins'"
        if problem:
            raise file_error(config.source, f"robot {robot!r} {problem}", f"robots.{robot}")
        self._config = config
        self._name = robot
        self._wanted = wanted
        self.endpoints: Final = endpoints_of(robot_config(config, robot))
        self.is_behind_router: Final = wanted.address == BEHIND_ROUTER
        self._shares = shared is not None
        self._fleet = shared if shared is not None else Fleet(_local(config, [robot]))
        self._shared_host = host
        self._host: RobotHost | None = None
        self._server: RobotServer | None = None
        self._server_lock = threading.Lock()
        self._failure: EALError | None = None
        self._stack = ExitStack()
        self.dead_man_trips: dict[str, int] = {}

    @property
    def robot(self) -> RobotHandle:
        """The robot in this process."""
        return self._fleet[self._name]

    def open(self) -> Self:
        """Start the robot, then open the network, so that controllers find it ready.

        Raises:
            ConfigError: its plugins refuse their settings; or `exclusive` names an unknown resource.
            DataError: it has more resources, or more text about them, than controllers take.
            RobotFailedError: it could not start.
            UnavailableError: the port is in use, or no router answers.

        Thread: blocks the caller.
        """
        self._warn_of_strangers()
        with ExitStack() as stack:
            if not self._shares:
                require_free(listening_at(robot_config(self._config, self._name)))
                stack.callback(self._fleet.close, _CLOSE_S)
                self._fleet.connect()
            self.robot.require_started()
            self._check_exclusive()
            host, keeper = self._shared_host, None
            if host is None:
                host, keeper = stack.enter_context(_hosting(self._config, [self._name]))
            self._host = host
            stack.callback(self._close_server)
            self._serve(host)
            stack.callback(self._halt)
            if keeper is not None:
                keeper.follow(host.move_to)
            self._stack = stack.pop_all()
        return self

    def _warn_of_strangers(self) -> None:
        if self._config.needs_identity([self._name]):
            get_logger(fleet=self._config.name, robot=self._name).warning(
                "the fleet has neither an identity nor keys: every fleet of its name commands the robot; "
                "set `network: {identity: NAME}` in its file, or serve it once by `eal serve`, which writes one"
            )

    def _serve(self, host: RobotHost) -> None:
        self._server = host.serve(self.robot, self._wanted.exclusive)
        self._server.dead_man_trips = self.dead_man_trips

    def _close_server(self) -> None:
        if self._server is not None:
            self._server.close()

    def reload(self) -> FleetChanges:
        """Read the fleet file again, and adopt its changes of the robot; controllers reconnect by themselves.

        Raises:
            ConfigError: the file is wrong, or changes what cannot change while the robot is served: its address,
                `listen`, `exclusive`, the network, and what Fleet.reload refuses. Nothing has changed then.
            DataError: as `open`. The robot is then restarted as it was, and served again.
            UnavailableError: the service is not open; or another process has taken the robot's place behind a router,
                and `wait` raises it too.
            UnsupportedError: the robot shares the process with others.

        Thread: any; blocks the caller.
        """
        if self._shares:
            raise UnsupportedError("robots that share a process are not reloaded: restart `eal serve`")
        config = EALConfigManager.load(self._config.source).fleet
        self._refuse_changes(config)
        with self._server_lock:
            changes = self._fleet.check_reload(_local(config, [self._name]))
            if self._host is not None and changes.restarted:
                self._replace(self._host, _local(config, [self._name]))
        return changes

    def _replace(self, host: RobotHost, config: FleetConfig) -> None:
        """Serve the robot of another configuration, or else, with its error, of the former one."""
        former = self._fleet.config
        self._close_server()  # controllers see the robot leave, and then come back as it is
        try:
            self._restart(host, config)
        except EALError as error:
            try:
                self._restart(host, former)
            except EALError as last:
                self._failure = last
                raise
            error.add_note("The robot was restarted with the former settings. Correct the file, then reload it again.")
            raise

    def _restart(self, host: RobotHost, config: FleetConfig) -> None:
        self._fleet.reload(config)
        self._serve(host)

    def _refuse_changes(self, config: FleetConfig) -> None:
        robot = config.robots.get(self._name)
        path: tuple[str, ...] = ("robots", self._name)
        if robot is None:
            raise ConfigError([config.tree.problem(path, f"robot {self._name!r} is served; end `eal serve` first")])
        keys = ("address", "listen", "exclusive")
        changed = [(*path, key) for key in keys if getattr(robot, key) != getattr(self._wanted, key)]
        if config.network != self._config.network:
            changed.append(("network",))
        why = "cannot change while the robot is served; restart `eal serve`"
        if changed:
            raise ConfigError([config.tree.problem(one, f"'{one[-1]}' {why}") for one in changed])

    def wait(self) -> None:
        """Wait until the server crashes, or the service is closed.

        Raises:
            UnavailableError: the server has crashed, or not come back from a reload; restart the process.
            RuntimeError: it is not open.

        Thread: blocks the caller.
        """
        if self._server is None:
            raise RuntimeError(f"the service of {self._name} is not open")
        ended = None
        while self._server is not ended:
            ended = self._server
            ended.wait()
            with self._server_lock:  # a reload replaces it
                pass
        if self._failure is not None:
            raise self._failure

    def _check_exclusive(self) -> None:
        source, path = str(self._config.source), f"robots.{self._name}.exclusive"
        unknown = [name for name in self._wanted.exclusive or () if name not in self.robot]
        if problems := [Problem(source, 0, 0, path, unknown_name("resource", name, self.robot)) for name in unknown]:
            raise ConfigError(problems)

    def _halt(self) -> None:
        """Stop all motion and refuse new motion, while controllers can still receive the outcome."""
        with suppress(EALError):
            self.robot.end_motion().get(timeout=self.robot.clock.of_real(_CLOSE_S / 3))

    def close(self) -> None:
        """Halt everything, leave the network and stop the robot. Closing it twice is harmless.

        Thread: blocks the caller, for a bounded time.
        """
        self._stack.close()

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(self, *_exc_info: object) -> None:
        self.close()


@contextmanager
def serve_together(config: FleetConfig, robots: Sequence[str]) -> Iterator[tuple[RobotService, ...]]:
    """Serve robots that share this process, such as all robots and trackers of one simulated world.

    Those of one address share a session too: calls that wait together to them travel in one message. With certificates
    they cannot, as each has its own. Raises EALError as for RobotService. Thread: blocks the caller while it opens and
    closes.
    """
    services = []
    for name in robots:
        require_free(listening_at(robot_config(config, name)))
    with Fleet(_local(config, robots)).connect() as fleet, ExitStack() as stack:
        for neighbours in _neighbours(config, robots):
            if len(neighbours) == 1:
                services.append(stack.enter_context(RobotService(config, neighbours[0], fleet)))
                continue
            host, keeper = stack.enter_context(_hosting(config, neighbours))
            services += [stack.enter_context(RobotService(config, name, fleet, host)) for name in neighbours]
            keeper.follow(host.move_to)
        yield tuple(sorted(services, key=lambda service: robots.index(service.robot.name)))


def _neighbours(config: FleetConfig, robots: Sequence[str]) -> list[list[str]]:
    """Return the robots that may share a session, in groups."""
    if config.network.security is not None:
        return [[name] for name in robots]
    groups: dict[str | None, list[str]] = {}
    for name in robots:
        groups.setdefault(config.robots[name].listen or config.robots[name].address, []).append(name)
    return list(groups.values())


@contextmanager
def _hosting(config: FleetConfig, robots: Sequence[str]) -> Iterator[tuple[RobotHost, SessionKeeper]]:
    """Open the session of robots of one address, and receive their calls; its keeper does not watch it yet."""
    name = robots[0]
    keeper = SessionKeeper(name, config.network, lambda: robot_config(config, name))
    try:
        host = RobotHost(config.network_name, keeper.open(), config.network, name if len(robots) == 1 else None)
        with sharing_processor(len(robots)):
            host.launch()
        try:
            yield host, keeper
        finally:
            host.close(_CLOSE_S)
    finally:
        keeper.close()


def _local(config: FleetConfig, robots: Iterable[str]) -> FleetConfig:
    """Return the fleet of some robots, in this process, which is going to have sessions."""
    take_turns()
    limit_heaps()
    return replace(config, robots={name: replace(config.robots[name], address=None, listen=None) for name in robots})
