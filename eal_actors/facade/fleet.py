"""Fleet: the concurrent API. Robots by name, tag or type; every call returns a future at once."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, Self, TypeVar

from eal_actors.actors.handles import CLOSE_TIMEOUT_S, RobotHandle, close_robots
from eal_actors.actors.robot_view import RobotState
from eal_actors.device.info import unknown_name
from eal_actors.device.plugin_context import FleetServices
from eal_actors.device.world import NamedPlace
from eal_actors.facade.fix_forwarding import FixForwarder
from eal_actors.facade.fleet_calls import FleetCalls
from eal_actors.facade.fleet_table import fleet_table
from eal_actors.facade.robot_starter import RobotStarter
from eal_actors.facade.shutdown import close_on_exit, forget, is_to_close
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import (
    EALError,
    PlaceNotFoundError,
    RobotFailedError,
    RobotNotFoundError,
    UnavailableError,
)
from eal_actors.kernel.lock_step import clock_of
from eal_actors.kernel.log import get_logger
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_changes import FleetChanges, changes_between
from eal_actors.managers.fleet_model import FleetConfig, RobotConfig

R = TypeVar("R")

START_TIMEOUT_S: Final = 30.0
"""Real seconds that `connect` waits for the robots to start."""


class Fleet(FleetCalls):
    """The robots of one fleet file.

        with Fleet.load("fleets/sim.yaml") as fleet:
            gather(robot["Base"].send_cmd("r45") for robot in fleet.values()).get()

    Any number of threads and controllers may use a fleet at the same time. Without a clock, it makes one of the file's
    rate.
    """

    def __init__(self, config: FleetConfig, clock: Clock | None = None) -> None:
        super().__init__()
        if not isinstance(config, FleetConfig):
            raise TypeError(f"a Fleet is made of a FleetConfig; Fleet.load reads a file, not Fleet({config!r})")
        self.config = config
        self.clock = clock if clock is not None else clock_of(config.rate)
        self._starter = RobotStarter(config, self.clock)
        self.services: FleetServices = self._starter.services
        self._robots: dict[str, RobotHandle] = {}
        self._forwarder = FixForwarder(self.clock)
        self._environment: Mapping[str, str] | None = None
        self._start_lock = threading.Lock()
        self._reload_lock = threading.Lock()

    @classmethod
    def load(cls, path: str | Path, *, environment: Mapping[str, str] | None = None) -> Fleet:
        """Read a fleet file, or a bundled one by its name such as `sim`, without connecting a robot.

        Without an environment, `${NAME}` in the file has the values of the process's environment. Raises ConfigError if
        the file is invalid; the error lists every problem.
        """
        fleet = cls(EALConfigManager.load(path, environment=environment).fleet)
        fleet._environment = environment
        return fleet

    # Connection.

    def connect(self, robots: Iterable[str] | None = None, *, timeout_s: float = START_TIMEOUT_S) -> Self:
        """Connect the robots and wait until each is up or has failed.

        A robot that fails does not stop the others: see its `state` and `problems`, and the log. Robots that are
        connected already stay connected. While a fleet is connected, SIGTERM and SIGHUP halt the robots; see
        `eal_actors.facade.shutdown`.

        Args:
            robots: the names of the robots to connect, with the trackers of their poses; all if None.
            timeout_s: real seconds to wait at most until another robot is up: a thousand take longer than one. A robot
                that is late continues to start.

        Raises:
            ConfigError: a plugin does not exist or refuses its settings, or the rate is max and robots are in other
                processes. Nothing is connected then.
            RobotNotFoundError: the fleet has no robot of one of the names.
            UnavailableError: robots are in other processes, and this one is a fork of a program that has used the
                network. Nothing is connected then.

        Thread: blocks the caller.
        """
        chosen = EALConfigManager(self.config).select(robots)
        names = {name for robot in chosen for name in (robot.name, *robot.pose.trackers)}
        wanted = [robot for name, robot in self.config.robots.items() if name in names]
        self._starter.check(wanted)
        try:
            with self._start_lock:
                close_on_exit(self.close, self._leave)
                self.clock.sleep(0)  # from here on a lock-step clock counts this thread
                for robot in wanted:  # one by one: `close` must know each if Ctrl-C strikes
                    if robot.name not in self._robots:
                        self._robots = {**self._robots, robot.name: self._start(robot)}
            self._wait_started([robot.name for robot in wanted], timeout_s)
            with self._start_lock:
                self._forwarder.follow(self.config, self._robots)
        except BaseException:
            self.close()
            raise
        return self

    def _wait_started(self, names: Iterable[str], timeout_s: float) -> None:
        """Wait until the robots are up or have failed, as long as one comes up every `timeout_s` real seconds."""
        begin_s, patience_s = self.clock.now(), self.clock.of_real(timeout_s)
        end_s = begin_s + patience_s
        for name in names:
            robot, now_s = self[name], self.clock.now()
            is_starting = not robot.has_started
            try:
                robot.wait_started(max(0.0, end_s - now_s), now_s - begin_s)
                if is_starting:
                    end_s = self.clock.now() + patience_s
            except RobotFailedError:  # its actor has logged the reason
                pass
            except UnavailableError as error:
                if robot.state is RobotState.LOST:  # its connection has logged the reason
                    continue
                get_logger(robot=name).error("robot is late", reason=error.message)

    def reload(self, config: FleetConfig | None = None, *, timeout_s: float = START_TIMEOUT_S) -> FleetChanges:
        """Read the fleet file again, and adopt its changes while the fleet is open (Source: thesis §4.3.1).

        New robots are connected, missing ones are halted and disconnected, and those whose address, plugins, settings
        or limits have changed are halted and connected anew. All others continue their commands. The handle of a
        restarted robot stays valid; the handles of its resources do not. Like `connect`, it waits until the robots that
        it starts are up or have failed.

        Args:
            config: the new configuration; read from the fleet's file if None.
            timeout_s: real seconds to wait at most until another robot is up.

        Returns the robots that changed.

        Raises:
            ConfigError: the file is wrong, or changes what cannot change while the fleet is open: its name, clock, seed
                and world, the network of connected robots, or a setting that its plugin refuses to change. Nothing has
                changed then.
            UnavailableError: the fleet is not connected.

        Thread: blocks the caller.
        """
        with self._reload_lock:
            changes, starter = self._plan_reload(config)
            ended = [self._robots[name] for name in (*changes.removed, *changes.restarted) if name in self._robots]
            close_robots(ended)
            with self._start_lock:
                if not self._robots:
                    raise UnavailableError(f"fleet {self.name!r} was closed during its reload")
                starter.take_over(self._starter)
                starter.end_sessions(CLOSE_TIMEOUT_S, [robot.name for robot in ended])
                self.config, self._starter = starter.config, starter
                self._adopt(changes)
            started = [name for name in (*changes.added, *changes.restarted) if name in self._robots]
            self._wait_started(started, timeout_s)
            with self._start_lock:
                self._forwarder.follow(self.config, self._robots)
        get_logger(fleet=self.name).info("fleet file reloaded", changes=str(changes))
        return changes

    def check_reload(self, config: FleetConfig | None = None) -> FleetChanges:
        """Return what `reload` would change, and raise what it would raise. Thread: any."""
        return self._plan_reload(config)[0]

    def _plan_reload(self, config: FleetConfig | None) -> tuple[FleetChanges, RobotStarter]:
        if not self._robots:
            raise UnavailableError(f"fleet {self.name!r} is not connected; `connect` it before `reload`")
        if config is None:
            config = EALConfigManager.load(self.config.source, environment=self._environment).fleet
        changes = changes_between(self.config, config)
        config = replace(config, rate=self.config.rate, seed=self.config.seed)  # a program may have replaced them
        starter = RobotStarter(config, self.clock)
        starter.check_changes(changes, self._starter)
        return changes, starter

    def _adopt(self, changes: FleetChanges) -> None:
        """Start and label the robots of a reload. Thread: holds the start lock."""
        robots = {}
        for name, robot in self.config.robots.items():
            handle = self._robots.get(name)
            if name in changes.added:
                robots[name] = self._start(robot)
            elif handle is not None:
                handle.label(robot.types, robot.tags)
                if name in changes.restarted:
                    handle.restart(partial(self._starter.start, robot))
                robots[name] = handle
        self._robots = robots

    def _start(self, robot: RobotConfig) -> RobotHandle:
        return RobotHandle(partial(self._starter.start, robot), robot.name, robot.types, robot.tags)

    def close(self, timeout_s: float = CLOSE_TIMEOUT_S) -> None:
        """Halt all motion, disconnect every robot and end its threads. Closing it twice is harmless.

        A robot that is stuck is abandoned after `timeout_s` real seconds. In a child process of `os.fork` it does
        nothing: the robots are the parent's. Thread: blocks the caller.
        """
        if not is_to_close(self.close):
            return
        with self._start_lock:
            robots = dict(self._robots)
            self._forwarder.close()
        self._end_traffic(timeout_s)
        close_robots(list(robots.values()), timeout_s)  # they stay known until then, in case of Ctrl-C
        with self._start_lock:
            self._robots = {name: robot for name, robot in self._robots.items() if robots.get(name) is not robot}
            if not self._robots:
                self._starter.end_sessions(timeout_s)
                forget(self.close)

    def _leave(self, error: EALError) -> None:
        for robot in self._robots.values():
            robot.leave(error)

    def __enter__(self) -> Self:
        return self if self._robots else self.connect()

    def __exit__(self, *_exc_info: object) -> None:
        self.close()

    # Robots.

    @property
    def name(self) -> str:
        """The fleet's name."""
        return self.config.name

    def __repr__(self) -> str:
        return f"<Fleet {self.name}: {len(self.config.robots)} robots, {'open' if self._robots else 'closed'}>"

    def _repr_html_(self) -> str:
        """Return a table of the robots, which notebooks show."""
        return fleet_table(self.config, self._robots)

    def __getitem__(self, name: str) -> RobotHandle:
        """Return a robot. Raises RobotNotFoundError if the fleet has no such robot, or is not connected."""
        try:
            return self._robots[name]
        except KeyError:
            if name in self.config.robots:
                raise RobotNotFoundError(
                    f"robot {name!r} of fleet {self.name!r} is not connected; use `with fleet:` or fleet.connect()"
                ) from None
            raise RobotNotFoundError(unknown_name("robot", name, self.config.robots)) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._robots)

    def __len__(self) -> int:
        return len(self._robots)

    __hash__ = object.__hash__
    __eq__ = object.__eq__  # by identity, unlike other mappings

    def select(
        self,
        names: Iterable[str] | None = None,
        *,
        tags: Iterable[str] | None = None,
        types: Iterable[str] | None = None,
    ) -> list[RobotHandle]:
        """Return the robots that match all arguments, in the order of the fleet file; a type matches derived ones too.

        Raises RobotNotFoundError if the fleet has no such name, tag or type.
        """
        chosen = EALConfigManager(self.config).select(names, tags=tags, types=types)
        return [self[robot.name] for robot in chosen]

    def place(self, name: str) -> NamedPlace:
        """Return a place of the fleet's world by its name: `fleet.place("dock").x_m`.

        Raises PlaceNotFoundError if the world has no such place, or the fleet file names no world.
        """
        if self.config.world is None:
            raise PlaceNotFoundError(f"no place {name!r}: fleet {self.name!r} has no world; give its file a `world`")
        return self.config.world.place(name)

    @property
    def problems(self) -> list[EALError]:
        """The errors of robots and plugins so far."""
        return [problem.at(robot.name) for robot in self._robots.values() for problem in robot.problems]
