"""Typed handles: what users hold. They name a resource or robot, so they survive a restart of what they name."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final, TypeVar

from eal_actors.actors.call import Call, ResourceCell
from eal_actors.actors.combine import gather
from eal_actors.actors.feeds import Encoding, Feed, Sink, StreamSpec
from eal_actors.actors.future import Future
from eal_actors.actors.polling import PolledFeed
from eal_actors.actors.robot_view import Ping, RobotConnection, RobotState, RobotView
from eal_actors.actors.streams import Stream
from eal_actors.clock import REAL_TIME, Clock
from eal_actors.data import EALData
from eal_actors.errors import (
    ArgumentError,
    EALError,
    ResourceNotFoundError,
    RobotFailedError,
    UnavailableError,
    WaitTimeoutError,
)
from eal_actors.info import ResourceInfo, unknown_name
from eal_actors.link import Link
from eal_actors.log import get_logger
from eal_actors.resource import Resource

T = TypeVar("T")

CLOSE_TIMEOUT_S: Final = 5.0
"""How long (real time) a robot has to stop by itself before what is stuck is abandoned."""


def _as_data(value: Any) -> EALData | None:
    return None if value is None else EALData.of(value)


class ResourceHandle:
    """One resource of one robot. Every call returns a future at once, and never blocks.

    A call fails through its future: BusyError when the mailbox is full, UnavailableError while the resource is
    restarting, DeadlineError when no answer came in time, UnsupportedError when the resource lacks the method,
    ArgumentError when it refuses the argument, ResourceFaultError when its own code raised. `timeout_s` is in seconds
    of the fleet's clock; None takes the fleet file's default.

    Thread: any; handles may be shared.
    """

    __slots__ = ("_cell",)

    def __init__(self, cell: ResourceCell) -> None:
        self._cell = cell

    def __repr__(self) -> str:
        return f"<ResourceHandle {self._cell.robot}/{self._cell.name}>"

    @property
    def name(self) -> str:
        """The resource's name on its robot."""
        return self._cell.name

    @property
    def robot(self) -> str:
        """The robot's name."""
        return self._cell.robot

    @property
    def link(self) -> Link:
        """What calls pass on their way."""
        return self._cell.link

    @property
    def info(self) -> ResourceInfo:
        """What the resource says of itself.

        Raises:
            UnavailableError: it has never been up.
        """
        if self._cell.info is None:
            raise self._cell.unavailable()
        return self._cell.info

    def start_call(
        self,
        method: str,
        arguments: tuple[Any, ...],
        timeout_s: float,
        begin_by_s: float | None = None,
        start_s: float | None = None,
    ) -> Call[Any]:
        """Call any method with its packed arguments, in the lane where it belongs: for servers.

        Args:
            method: one of the nine methods, or `halt`.
            arguments: the method's arguments, values as EALData.
            timeout_s: seconds of the fleet's clock until its deadline.
            begin_by_s: the fleet's time after which it must not begin any more; None for none.
            start_s: the fleet's time at which to begin; None for at once, as stops always do.

        Thread: any; does not block.
        """
        cell = self._cell
        call: Call[Any] = Call(cell, method, arguments, timeout_s)
        call.begin_by_s, call.start_s = begin_by_s, start_s
        info = cell.info
        stops = method == "halt" or (method == "send_cmd" and info is not None and arguments[0] in info.urgent_commands)
        if stops or method == "get_status":
            cell.submit_urgent(call, stops=stops)
        else:
            cell.submit(call)
        return call

    def open_feed(self, spec: StreamSpec, sink: Sink) -> Feed:
        """Have values brought to a sink until the feed is closed: for servers. Thread: any; does not block."""
        return PolledFeed(self._cell, spec, sink)

    def _call(
        self, method: str, arguments: tuple[Any, ...], timeout_s: float | None, at_s: float | None = None
    ) -> Call[Any]:
        cell = self._cell
        call: Call[Any] = Call(cell, method, arguments, cell.timeout_s if timeout_s is None else timeout_s)
        if at_s is not None:
            if not math.isfinite(at_s):
                call.fail(ArgumentError(f"at_s must be a time of the fleet's clock, not {at_s!r}"))
                return call
            call.start_s = at_s
        cell.submit(call)
        return call

    def _urgent_call(
        self, method: str, arguments: tuple[Any, ...], timeout_s: float | None, *, stops: bool
    ) -> Call[Any]:
        cell = self._cell
        call: Call[Any] = Call(cell, method, arguments, cell.timeout_s if timeout_s is None else timeout_s)
        cell.submit_urgent(call, stops=stops)
        return call

    def get_status(self, *, timeout_s: float | None = None) -> Future[int]:
        """Ask for the status; overtakes what waits, and is answered while a command runs."""
        return self._urgent_call("get_status", (), timeout_s, stops=False)

    def get_value(self, *, timeout_s: float | None = None) -> Future[EALData]:
        """Ask for the value."""
        return self._call("get_value", (), timeout_s)

    def set_value(self, value: Any, *, timeout_s: float | None = None, at_s: float | None = None) -> Future[int]:
        """Set the value; the answer is a status int. `at_s` is as with send_cmd."""
        return self._call("set_value", (EALData.of(value),), timeout_s, at_s)

    def send_req(self, req: str, *, timeout_s: float | None = None) -> Future[EALData]:
        """Send a request; the answer is its data."""
        return self._call("send_req", (req,), timeout_s)

    def send_cmd(
        self, cmd: str, data: Any = None, *, timeout_s: float | None = None, at_s: float | None = None
    ) -> Future[int]:
        """Send a command; the future is done when the command is, with a status int.

        A newer command takes over from a running one, whose future fails with PreemptedError. A stop overtakes
        everything that waits, and drops the commands that wait.

        Args:
            cmd: the command.
            data: its argument, where its text does not hold it.
            timeout_s: seconds of the fleet's clock until its deadline, which counts from now on.
            at_s: when to begin, by the fleet's clock; None, or a time that is past when the resource reads it, for at
                once. Until then the resource goes on with what it does, and a newer command or a stop calls it off
                with PreemptedError. Stops take no time: they begin at once.
        """
        info, arguments = self._cell.info, (cmd, _as_data(data))
        if info is not None and cmd in info.urgent_commands:
            return self._urgent_call("send_cmd", arguments, timeout_s, stops=True)
        return self._call("send_cmd", arguments, timeout_s, at_s)

    def read_comm(self, length: int, *, timeout_s: float | None = None) -> Future[EALData]:
        """Read up to `length` bytes; the answer holds what was read."""
        return self._call("read_comm", (length,), timeout_s)

    def write_comm(self, data: Any, length: int | None = None, *, timeout_s: float | None = None) -> Future[int]:
        """Write the first `length` bytes, all if None; the answer is how many were written."""
        packed = EALData.of(data)
        return self._call("write_comm", (packed, packed.length if length is None else length), timeout_s)

    def get_config(self, key: str, *, timeout_s: float | None = None) -> Future[EALData]:
        """Ask for a configuration value."""
        return self._call("get_config", (key,), timeout_s)

    def set_config(self, key: str, value: Any = None, *, timeout_s: float | None = None) -> Future[int]:
        """Set a configuration value; the answer is a status int."""
        return self._call("set_config", (key, _as_data(value)), timeout_s)

    def halt(self, *, timeout_s: float | None = None) -> Future[int]:
        """Stop what moves, at once: overtakes everything, closes the running command, drops those that wait."""
        return self._urgent_call("halt", (), timeout_s, stops=True)

    def stream(self, rate_hz: float = 10.0, encoding: Encoding = "raw", *, timeout_s: float | None = None) -> Stream:
        """Read the newest value again and again; see Stream. Close it, as a `with` block does.

        Args:
            rate_hz: values in a second of the fleet's clock, at most; over 0, up to 1000.
            encoding: how images travel through a network: `raw`, `jpeg` (small, loses a little) or `png` (loses
                nothing). The reader gets an image in any case; within a process nothing is encoded.
            timeout_s: how long a reader waits for a value; None for the fleet file's default and one period.

        Raises:
            ArgumentError: such a rate or encoding does not exist, or the value is no uint8 image (height, width, 3).
            UnsupportedError: the resource has no value; or OpenCV is needed for the encoding and not installed.

        Thread: any; does not block.
        """
        spec = StreamSpec(rate_hz, encoding)
        return Stream(self._cell, spec, self._cell.timeout_s + spec.period_s if timeout_s is None else timeout_s)

    def resource(self) -> Resource:
        """Return the resource object itself (Source: thesis B.2.4). For debugging: its actor still uses it.

        Raises:
            UnavailableError: it is not up.
        """
        actor = self._cell.actor
        if actor is None or actor.resource is None:
            raise self._cell.unavailable()
        return actor.resource


class RobotHandle(Mapping[str, ResourceHandle]):
    """One robot of a fleet: its resources by name.

    Attributes:
        name: the robot's name.
        type: its type's name in the fleet file, or None.
        types: its type and what that builds on.
        tags: its tags.
    """

    def __init__(
        self,
        start: Callable[[], tuple[RobotConnection, RobotView]],
        name: str,
        types: tuple[str, ...] = (),
        tags: tuple[str, ...] = (),
    ) -> None:
        self.name = name
        self.types = types
        self.type = types[0] if types else None
        self.tags = tags
        self._actor, self._view = start()

    def __repr__(self) -> str:
        return f"<RobotHandle {self.name}: {self.state.value}>"

    @property
    def state(self) -> RobotState:
        """Where the robot is in its life."""
        return self._view.state

    @property
    def problems(self) -> tuple[EALError, ...]:
        """What kept plugins out, or made the robot fail."""
        return self._view.problems

    @property
    def restarts(self) -> Mapping[str, int]:
        """How often each resource was restarted."""
        return dict(self._view.restarts)

    def __getitem__(self, name: str) -> ResourceHandle:
        """Return the handle of a resource.

        Raises:
            ResourceNotFoundError: the robot has no such resource.
            RobotFailedError: the robot failed before it had any resource.
        """
        cell = self._view.cells.get(name)
        if cell is not None:
            return ResourceHandle(cell)
        if not self._view.cells and self.state is RobotState.FAILED:
            raise self._failed()
        if not self._view.cells and self.state in (RobotState.LOST, RobotState.STARTING):
            raise self._unreached()
        left_out = "".join(f"; left out: {problem.message}" for problem in self.problems)
        raise ResourceNotFoundError(unknown_name("resource", name, self._view.cells) + left_out, robot=self.name)

    def __contains__(self, name: object) -> bool:
        return name in self._view.cells  # Mapping's own asks __getitem__, which raises where the robot has failed

    def __iter__(self) -> Iterator[str]:
        return iter(self._view.cells)

    def __len__(self) -> int:
        return len(self._view.cells)

    __hash__ = object.__hash__
    __eq__ = object.__eq__  # a robot is itself, not what it holds

    def halt(self, *, timeout_s: float | None = None) -> Future[list[int]]:
        """Stop whatever moves on this robot, at once; see ResourceHandle.halt."""
        return gather([self[name].halt(timeout_s=timeout_s) for name in self])

    @property
    def is_remote(self) -> bool:
        """Whether the robot is in another process, and reached over a network."""
        return self._actor.is_remote

    @property
    def clock(self) -> Clock:
        """The fleet's clock."""
        return self._view.clock

    def ping(self) -> Future[Ping]:
        """Ask the robot how it is, how long the way to it takes, and how far its clock is from ours.

        A robot of this process answers at once, without having been asked; one that cannot be reached fails with
        UnavailableError. Each ping makes the offset of the clocks better known.

        Thread: any; does not block.
        """
        return self._actor.ping()

    @property
    def stopped_because(self) -> str | None:
        """Why an emergency stop holds the robot; None if none does."""
        return self._view.latch.reason

    def stop(self, reason: str = "") -> Future[None]:
        """Emergency stop: halt whatever moves, and refuse motions with StoppedError until `resume`.

        Args:
            reason: told to those whose motions are refused.

        Thread: any; does not block.
        """
        return self._actor.stop_now(reason)

    def resume(self) -> Future[None]:
        """End an emergency stop: motions are possible again, and none starts by itself. Thread: any; does not block."""
        return self._actor.resume()

    def wait_started(self, timeout_s: float) -> None:
        """Wait until every resource is up.

        Args:
            timeout_s: seconds of the fleet's clock to wait at most.

        Raises:
            RobotFailedError: it could not start.
            UnavailableError: it did not start in time.

        Thread: blocks the caller.
        """
        try:
            self._view.started.get(timeout=timeout_s)
        except WaitTimeoutError:
            late = [name for name, cell in self._view.cells.items() if cell.actor is None]
            what = f"{', '.join(late)} did not start" if late else "its plugins did not connect"
            raise UnavailableError(f"{what} within {timeout_s:g} s", robot=self.name) from None
        if self.state is RobotState.FAILED:
            raise self._failed()
        if self.state is RobotState.LOST:
            raise self._unreached()

    def require_started(self) -> None:
        """Raise unless every resource has been up.

        Raises:
            RobotFailedError: it could not start, or has given up.
            UnavailableError: it has not started yet.
        """
        if not self._view.started.done():
            raise UnavailableError("has not started yet; see the log, or give connect more time", robot=self.name)
        if self.state is RobotState.FAILED:
            raise self._failed()
        if self.state is RobotState.LOST:
            raise self._unreached()

    def _unreached(self) -> UnavailableError:
        message = self.problems[-1].message if self.problems else "has not started yet"
        return UnavailableError(message, robot=self.name)

    def _failed(self) -> RobotFailedError:
        message = self.problems[-1].message if self.problems else "has failed"
        return RobotFailedError(message, robot=self.name)

    def begin_close(self) -> None:
        """Start to stop the robot. Thread: any; does not block."""
        self._actor.shut_down()

    def close(self, timeout_s: float = CLOSE_TIMEOUT_S) -> None:
        """Halt every resource, disconnect the plugins, end every thread; see close_robots."""
        close_robots([self], timeout_s)


def close_robots(robots: Sequence[RobotHandle], timeout_s: float = CLOSE_TIMEOUT_S) -> None:
    """Halt every resource, disconnect the plugins, end every thread, of all robots at once.

    What is stuck is abandoned, and named in the log.

    Args:
        robots: the robots.
        timeout_s: real seconds for them to stop by themselves.

    Thread: blocks the caller, at most about twice `timeout_s` however many robots there are. In a thread of one of the
    robots, such as a done-callback's, it does not wait for that robot.
    """
    for robot in robots:  # before time may go on without this thread, or motions would end that are to be stopped
        robot.begin_close()
    with contextlib.ExitStack() as stack:
        for clock in dict.fromkeys(robot._actor.clock for robot in robots):
            stack.enter_context(clock.outside())
        _close_robots(robots, timeout_s)


def _close_robots(robots: Sequence[RobotHandle], timeout_s: float) -> None:
    waiting = [robot for robot in robots if not robot._actor.is_at_work()]
    late = _not_stopped(waiting, timeout_s)
    for robot in late:
        robot._actor.force_down()
    for robot in _not_stopped(late, timeout_s / 2):
        robot._actor.abandon(UnavailableError("the robot was stuck while it was closed"))
    end_s = REAL_TIME.now() + timeout_s / 2
    for robot in waiting:
        if alive := robot._actor.join(end_s - REAL_TIME.now()):
            get_logger(robot=robot.name).error("threads are stuck and were left behind", threads=alive)


def _not_stopped(robots: Sequence[RobotHandle], timeout_s: float) -> list[RobotHandle]:
    """Wait for robots to stop; return those that have not."""
    end_s = REAL_TIME.now() + timeout_s
    late = []
    for robot in robots:
        try:
            robot._view.stopped.get(timeout=max(0.0, end_s - REAL_TIME.now()))
        except WaitTimeoutError:
            late.append(robot)
    return late
