"""Calls to many robots of a fleet at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

from eal_actors.actors.combine import gather
from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.actors.many import by_robot, read_many, send_many
from eal_actors.device.data import EALData
from eal_actors.facade.synchronized_start import Command, SynchronizedCommands, send_synchronized
from eal_actors.facade.tasks import TaskGroup
from eal_actors.facade.traffic.travelling import TravellingRobots
from eal_actors.kernel.clock import Clock

R = TypeVar("R")


class FleetCalls(TravellingRobots, Mapping[str, RobotHandle]):
    """The calls of a fleet that concern many robots."""

    clock: Clock

    def each(
        self,
        robots: Iterable[RobotHandle | str],
        function: Callable[[RobotHandle], R],
        *,
        timeout_s: float | None = None,
    ) -> dict[str, R]:
        """Run `function(robot)` for every robot at the same time; return the results by the robots' names.

            def drive_home(robot: RobotHandle) -> int:
                robot["Base"].send_cmd("r180").get()
                return robot["Base"].send_cmd("f1").get()

            statuses = fleet.each(fleet.select(tags=["indoor"]), drive_home, timeout_s=60)

        Each robot's function runs in a thread of its own, on the fleet's clock, and calls block only that thread. When
        one raises, when the time is over, and on Ctrl-C, the waits of all others raise CallCancelledError, all robots
        given are halted, and the error is raised here once every thread has ended; see `eal_actors.facade.tasks`.

        Args:
            robots: the robots or their names, each once.
            function: what to run. It should let CallCancelledError pass.
            timeout_s: seconds of the fleet's clock for all of them together; None for no limit.

        Raises:
            ArgumentError: a robot is given twice.
            RobotNotFoundError: the fleet has no robot of a name.
            DeadlineError: the time is over.
            Exception: the first error of a function. Errors that others raised too are its notes.

        Thread: any; blocks the caller.
        """
        handles = self._chosen(robots)
        with self.tasks(timeout_s) as tasks:
            results = {robot.name: tasks.start(function, robot) for robot in handles}
        return {name: result.get() for name, result in results.items()}

    def read(
        self,
        robots: Iterable[RobotHandle | str],
        resource: str,
        *,
        return_exceptions: bool = False,
        timeout_s: float | None = None,
    ) -> Future[dict[str, EALData]]:
        """Read one resource of many robots; return one future of the values by the robots' names.

            poses = fleet.read(fleet.values(), "Pose").get()

        It costs less than `get_value` for each.

        Args:
            robots: the robots or their names, each once.
            resource: the resource's name, the same on each.
            return_exceptions: put errors in place of values; otherwise the future fails with the first one.
            timeout_s: seconds of the fleet's clock until the deadline of each call; None for the fleet file's default.

        Raises:
            ArgumentError: a robot is given twice.
            RobotNotFoundError: the fleet has no robot of a name.
            ResourceNotFoundError: a robot has no such resource. Nothing is read then.

        Thread: any. Code of resources with `any_thread` runs in the caller's thread; all else does not block.
        """
        handles = [robot[resource] for robot in self._chosen(robots)]
        return by_robot(handles, read_many(handles, timeout_s), return_exceptions=return_exceptions)

    def send(
        self,
        robots: Iterable[RobotHandle | str],
        resource: str,
        cmd: str,
        data: Any = None,
        *,
        return_exceptions: bool = False,
        timeout_s: float | None = None,
    ) -> Future[dict[str, int]]:
        """Send one command to a resource of many robots; return one future of the status ints by the robots' names.

            fleet.send(fleet.select(tags=["indoor"]), "Base", "f0.3").get()

        The future is done when every robot's command is; cancelling it cancels all. For commands that begin at the same
        instant, see `together`. `data` is the command's argument, where its text does not hold it. All other arguments,
        the errors and the thread are those of `read`.
        """
        handles = [robot[resource] for robot in self._chosen(robots)]
        return by_robot(handles, send_many(handles, cmd, data, timeout_s), return_exceptions=return_exceptions)

    def tasks(self, timeout_s: float | None = None) -> TaskGroup:
        """Return a group of tasks, for a `with` block: different functions at the same time, which end together.

        It waits for them at its end, for `timeout_s` seconds of the fleet's clock or without limit.
        """
        return TaskGroup(self.clock, timeout_s)

    def halt(self, *, timeout_s: float | None = None) -> Future[list[list[int]]]:
        """Stop all motion of every robot at once. Thread: any; does not block."""
        self._cancel_trips()
        return gather([robot.halt(timeout_s=timeout_s) for robot in self.values()])

    def together(
        self, commands: Mapping[ResourceHandle, Command], *, lead_s: float = 0.1, timeout_s: float | None = None
    ) -> SynchronizedCommands:
        """Send commands to many resources that begin at the same time, whatever the delay of each link.

            start = fleet.together({robot["Base"]: "r45" for robot in fleet.values()})
            print(start.record.get().skew_s)

        Pings compare the clocks of robots on the network first; the start allows for the slowest link. A command that
        arrives late begins on arrival, which the record shows. Stops do not wait.

        Args:
            commands: by resource, the command; or the command and its argument.
            lead_s: seconds of the fleet's clock until the start, in addition to the delay of the slowest link.
            timeout_s: seconds until the deadline of each command; None for the fleet file's default.

        Raises:
            RobotNotFoundError: a resource belongs to no robot of this fleet.
            ArgumentError: `lead_s` is negative or not finite.

        Thread: blocks the caller for a few round trips where robots are on the network, at most 0.5 s of real time.
        """
        robots = [self[name] for name in dict.fromkeys(handle.robot for handle in commands)]
        return send_synchronized(commands, robots, self.clock, lead_s, timeout_s)

    def stop(self, reason: str = "") -> Future[list[None]]:
        """Stop every robot in an emergency: halt all motion and refuse new motion until `resume`; see RobotHandle.stop.

        Thread: any; does not block.
        """
        self._cancel_trips()
        return gather([robot.stop(reason) for robot in self.values()])

    def resume(self) -> Future[list[None]]:
        """End the emergency stop of every robot. Thread: any; does not block."""
        return gather([robot.resume() for robot in self.values()])
