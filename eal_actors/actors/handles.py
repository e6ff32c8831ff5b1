"""The typed handles of robots, and closing them. A handle names a robot, so it survives restarts of its resources."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final

from typing_extensions import override

from eal_actors.actors.combine import gather
from eal_actors.actors.future import Future
from eal_actors.actors.part_handles import RobotParts
from eal_actors.actors.resource_handle import ResourceHandle
from eal_actors.actors.robot_view import Ping, RobotConnection, RobotState, RobotView, RunningCommand, StateFuture
from eal_actors.actors.stop_latch import SERVICE_ENDS
from eal_actors.device.info import unknown_name
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import (
    EALError,
    ResourceNotFoundError,
    RobotFailedError,
    UnavailableError,
    WaitTimeoutError,
)
from eal_actors.kernel.log import get_logger

__all__ = ["CLOSE_TIMEOUT_S", "ResourceHandle", "RobotHandle", "close_robots"]

MAX_REASON: Final = 500
"""Characters of the reason of an emergency stop; each ping and handshake contains it."""
CLOSE_TIMEOUT_S: Final = 5.0
"""Real time that a robot has to stop by itself before its stuck threads are abandoned."""
_LOOK_S: Final = 0.1
_AT_ONCE: Final = 20
"""Robots of this process that end at a time: 15,000 threads that wake together take minutes from each other."""


class RobotHandle(RobotParts, Mapping[str, ResourceHandle]):
    """One robot of a fleet: its resources by name, and its usual parts as typed handles.

    Attributes:
        type: its type's name in the fleet file, or None.
        types: its type and the types that it builds on.
        starts: how often the fleet has started its connection; a reload may start it anew.
    """

    def __init__(
        self,
        start: Callable[[], tuple[RobotConnection, RobotView]],
        name: str,
        types: tuple[str, ...] = (),
        tags: tuple[str, ...] = (),
    ) -> None:
        self.name = name
        self.label(types, tags)
        self.starts = 1
        self._actor, self._view = start()

    def label(self, types: tuple[str, ...], tags: tuple[str, ...]) -> None:
        """Set the types and tags; for the fleet."""
        self.types = types
        self.type = types[0] if types else None
        self.tags = tags

    def restart(self, start: Callable[[], tuple[RobotConnection, RobotView]]) -> None:
        """Start the robot's connection anew after `close`; for the fleet.

        Callbacks of `on_state` and an emergency stop stay. Handles of resources belong to the former connection.
        Thread: any; does not block.
        """
        actor, view = start()
        view.inherit(self._view)
        self._actor, self._view = actor, view
        self.starts += 1

    def leave(self, error: EALError) -> None:
        """Let calls fail with an error, without closing the connection; for the fleet. Thread: any; takes no lock."""
        for cell in self._view.cells.values():
            cell.error, cell.actor, cell.serve_now, cell.read_now = error, None, None, None

    def __repr__(self) -> str:
        return f"<RobotHandle {self.name}: {self.state.value}>"

    @property
    def state(self) -> RobotState:
        """The robot's state."""
        return self._view.state

    def on_state(self, callback: Callable[[RobotState], None]) -> Callable[[], None]:
        """Call back with the robot's state now and at each change; errors of the callback are logged.

        Returns a function that stops it; calling it twice is harmless. Thread: any; does not block. The callback runs
        in the robot's own thread, so it must not block.
        """
        return self._view.observe(callback)

    def wait_for_state(self, state: RobotState, timeout_s: float) -> Future[RobotState]:
        """Return a future that is done when the robot is in a state, at once if it is.

        It fails with DeadlineError after `timeout_s` seconds of the fleet's clock, and with UnavailableError as soon as
        the robot is disconnected or has failed for good. Raises ArgumentError if the time is NaN. Thread: any; does not
        block.
        """
        return StateFuture(self._view, state, timeout_s, self._actor.actor_inbox)

    @property
    def running(self) -> tuple[RunningCommand, ...]:
        """The running commands of all controllers on this robot, without those that end within an instant.

        A remote robot reports them: a command is listed once it has run for some 0.1 to 0.3 s, and its progress is at
        most as old. Nothing is listed while the robot is out of reach.
        """
        return self._actor.running()

    @property
    def problems(self) -> tuple[EALError, ...]:
        """The errors of plugins that did not connect, or of the robot's failure."""
        return self._view.problems

    @property
    def left_out(self) -> tuple[str, ...]:
        """Why resources may be missing: the messages of `problems`, and what connected plugins say."""
        return (*(problem.message for problem in self.problems), *self._view.left_out)

    @property
    def restarts(self) -> Mapping[str, int]:
        """How often each resource was restarted."""
        return dict(self._view.restarts)

    @property
    def not_ready(self) -> Mapping[str, str]:
        """Why resources are not ready, by their names: their devices are absent and are retried.

        A remote robot reports it when it is connected and in each answer to a ping.
        """
        return dict(self._view.not_ready)

    @override
    def __getitem__(self, name: str) -> ResourceHandle:
        """Return the handle of a resource.

        Raises:
            ResourceNotFoundError: the robot has no such resource.
            RobotFailedError: the robot failed before it had any resource.
        """
        if (cell := self._view.cells.get(name)) is not None:
            return ResourceHandle(cell)
        if not self._view.cells and self.state is RobotState.FAILED:
            raise self._failed()
        if not self._view.cells and self.state in (RobotState.LOST, RobotState.STARTING):
            raise self._unreached()
        left_out = "".join(f"; left out: {reason}" for reason in self.left_out)
        raise ResourceNotFoundError(unknown_name("resource", name, self._view.cells) + left_out, robot=self.name)

    @override
    def __contains__(self, name: object) -> bool:
        return name in self._view.cells  # Mapping's own asks __getitem__, which raises where the robot has failed

    @override
    def __iter__(self) -> Iterator[str]:
        return iter(self._view.cells)

    @override
    def __len__(self) -> int:
        return len(self._view.cells)

    __hash__ = object.__hash__
    __eq__ = object.__eq__  # two robots with equal resources are not the same robot

    def halt(self, *, timeout_s: float | None = None) -> Future[list[int]]:
        """Stop everything that moves on this robot, at once; see ResourceHandle.halt."""
        return gather([self[name].halt(timeout_s=timeout_s) for name in self])

    @property
    def is_remote(self) -> bool:
        """Whether the robot is in another process and reached over a network."""
        return self._actor.is_remote

    @property
    def clock(self) -> Clock:
        """The fleet's clock."""
        return self._view.clock

    def ping(self) -> Future[Ping]:
        """Return the robot's state, the round trip to it, and the offset of its clock from ours.

        A robot of this process answers at once; one that is out of reach fails with UnavailableError. Each ping
        improves the estimate of the offset. Thread: any; does not block.
        """
        return self._actor.ping()

    @property
    def stopped_because(self) -> str | None:
        """The reason of the emergency stop that holds the robot; None if none does."""
        return self._view.latch.emergency

    @property
    def is_stop_confirmed(self) -> bool:
        """Whether the robot has halted since its emergency stop. Until then it may still move."""
        return self._view.latch.is_confirmed

    def overtaken(self, sent_s: float) -> EALError | None:
        """Return the error of a motion that was sent at a real time, if an emergency stop came later; for servers."""
        return self._view.latch.overtaken(sent_s)

    def stop(self, reason: str = "") -> Future[None]:
        """Stop in an emergency: halt everything that moves, and refuse motions with StoppedError until `resume`.

        A robot on the network gets the stop again and again until it confirms it; see `is_stop_confirmed`. `reason`
        appears in the errors of refused motions. Thread: any; does not block.
        """
        return self._actor.stop_now(str(reason)[:MAX_REASON])

    def end_motion(self) -> Future[None]:
        """Halt everything that moves, and refuse motions with UnavailableError: the robot's service ends."""
        self._view.latch.end_service()
        return self._actor.stop_now(SERVICE_ENDS)

    def resume(self) -> Future[None]:
        """End an emergency stop: motions are possible again, and none starts by itself. Thread: any; does not block."""
        return self._actor.resume()

    @property
    def controller_id(self) -> str | None:
        """The id by which the robot knows this process, as in `Ping.holder_ids`; None for a robot of this process."""
        return self._view.controller_id

    def release(self, *resources: str) -> Future[None]:
        """Release resources that this process has commanded, so that another controller may command them at once.

        Otherwise they are free when the fleet is closed. Motions of ours are halted; a later command takes the resource
        anew. Resources that other controllers hold, or nobody holds, as within one process, are left as they are.
        Without `resources`, all of the robot's are released. Thread: any; does not block.
        """
        return self._actor.release(resources or tuple(self))

    @property
    def has_started(self) -> bool:
        """Whether it is up or has failed; else it is still starting. Thread: any."""
        return self._view.started.done()

    def wait_started(self, timeout_s: float, waited_s: float = 0.0) -> None:
        """Wait until every resource is up.

        Args:
            timeout_s: seconds of the fleet's clock to wait at most.
            waited_s: how long the caller has waited for it before, for the error's message.

        Raises:
            RobotFailedError: it could not start.
            UnavailableError: it did not start in time.

        Thread: blocks the caller.
        """
        try:
            self._view.started.get(timeout=timeout_s)
        except WaitTimeoutError:
            late = [name for name, cell in self._view.cells.items() if cell.actor is None]
            idle = "it did not answer" if self.is_remote else "its plugins did not connect"
            what = f"{', '.join(late)} did not start" if late else idle
            raise UnavailableError(f"{what} within {timeout_s + waited_s:.3g} s", robot=self.name) from None
        self._check_state()

    def require_started(self) -> None:
        """Raise unless every resource has been up.

        Raises:
            RobotFailedError: it could not start, or has given up.
            UnavailableError: it has not started yet.
        """
        if not self.has_started:
            raise UnavailableError("has not started yet; see the log, or give connect more time", robot=self.name)
        self._check_state()

    def _check_state(self) -> None:
        if self.state is RobotState.FAILED:
            raise self._failed()
        if self.state is RobotState.LOST:
            raise self._unreached()

    def _unreached(self) -> UnavailableError:
        return UnavailableError(self._last_problem("has not started yet"), robot=self.name)

    def _failed(self) -> RobotFailedError:
        return RobotFailedError(self._last_problem("has failed"), robot=self.name)

    def _last_problem(self, otherwise: str) -> str:
        problems = self.problems  # read once: a robot that comes back has none
        return problems[-1].message if problems else otherwise

    def close(self, timeout_s: float = CLOSE_TIMEOUT_S) -> None:
        """Halt every resource, disconnect the plugins, end every thread; see close_robots."""
        close_robots([self], timeout_s)


def close_robots(robots: Sequence[RobotHandle], timeout_s: float = CLOSE_TIMEOUT_S) -> None:
    """Halt every robot at once, then disconnect the plugins and end every thread, of some robots at a time.

    They have `timeout_s` real seconds to stop by themselves, which count anew whenever a thread ends, so that many
    robots on a busy machine are not taken for stuck ones. Stuck threads are abandoned and named in the log. Once a
    robot is stuck, all the others end at once. Thread: blocks the caller; if no thread ends, about three times
    `timeout_s` however many robots there are. In a thread of one of the robots, such as a done-callback's, it does not
    wait for that robot.
    """
    for place, robot in enumerate(robots):  # before time passes without this thread, and motions end by themselves
        robot._actor.shut_down() if place < _AT_ONCE else robot._actor.halt_before_end()
    with contextlib.ExitStack() as stack:
        for clock in dict.fromkeys(robot.clock for robot in robots):
            stack.enter_context(clock.outside())
        _end(robots, timeout_s)


def _end(robots: Sequence[RobotHandle], timeout_s: float) -> None:
    left, late = list(robots), list[RobotHandle]()
    while left:
        group, left = (left, []) if late else (left[:_AT_ONCE], left[_AT_ONCE:])
        for robot in group:
            robot._actor.shut_down()
        late += _not_stopped([robot for robot in group if not robot._actor.is_at_work()], timeout_s)
    _await_end([robot for robot in robots if not robot._actor.is_at_work()], late, timeout_s)


def _await_end(robots: Sequence[RobotHandle], late: Sequence[RobotHandle], timeout_s: float) -> None:
    for robot in late:
        robot._actor.force_down()
    for robot in _not_stopped(late, timeout_s / 2):
        robot._actor.abandon(UnavailableError("the robot was stuck while it was closed"))
    patience = _Patience(timeout_s / 2)
    for robot in robots:
        while (alive := robot._actor.join(patience.slice_s())) and patience.slice_s():
            pass
        if alive:
            get_logger(robot=robot.name).error("threads are stuck and were left behind", threads=alive)


def _not_stopped(robots: Sequence[RobotHandle], timeout_s: float) -> list[RobotHandle]:
    """Wait for robots to stop; return those that have not."""
    patience = _Patience(timeout_s)
    return [robot for robot in robots if not _has_stopped(robot, patience)]


def _has_stopped(robot: RobotHandle, patience: _Patience) -> bool:
    while True:
        slice_s = patience.slice_s()
        try:
            robot._view.stopped.get(timeout=slice_s)
        except WaitTimeoutError:
            if not slice_s:
                return False
        else:
            return True


class _Patience:
    """A time limit in real seconds that begins anew whenever a thread of the process has ended.

    A wait counts only as long as was asked for: one that ends later has waited for a processor, not for a robot.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = self._left_s = limit_s
        self._threads = threading.active_count()
        self._looked_s, self._slice_s = REAL_TIME.now(), 0.0

    def slice_s(self) -> float:
        """Return how long to wait before the next look; 0 at the end."""
        now_s, threads = REAL_TIME.now(), threading.active_count()
        self._left_s -= min(now_s - self._looked_s, self._slice_s)
        if threads < self._threads:
            self._threads, self._left_s = threads, self._limit_s
        self._looked_s, self._slice_s = now_s, max(0.0, min(self._left_s, _LOOK_S))
        return self._slice_s
