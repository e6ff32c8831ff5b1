"""Typed handles: what users hold. They name a resource or robot, so they survive a restart of what they name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

from eal_actors.actors.closing import CLOSE_TIMEOUT_S, close_all
from eal_actors.actors.combine import gather
from eal_actors.actors.future import Future
from eal_actors.actors.resource_handle import ResourceHandle
from eal_actors.actors.robot_view import Ping, RobotConnection, RobotState, RobotView
from eal_actors.actors.running import Running
from eal_actors.actors.state_wait import StateWait
from eal_actors.device.info import unknown_name
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import (
    EALError,
    ResourceNotFoundError,
    RobotFailedError,
    UnavailableError,
    WaitTimeoutError,
)

__all__ = ["CLOSE_TIMEOUT_S", "ResourceHandle", "RobotHandle", "close_robots"]


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

    def on_state(self, callback: Callable[[RobotState], None]) -> Callable[[], None]:
        """Call back with the robot's state now, and with each later one; errors of the callback are logged.

        Returns:
            What ends it; calling it twice is harmless.

        Thread: any; does not block. The callback runs in the robot's own thread, so it must not block.
        """
        return self._view.observe(callback)

    def wait_for_state(self, state: RobotState, timeout_s: float) -> Future[RobotState]:
        """Return a future that is done when the robot is in a state, at once if it is.

        It fails with DeadlineError after `timeout_s` seconds of the fleet's clock, and with UnavailableError as soon as
        the robot is disconnected or has failed for good.

        Thread: any; does not block.
        """
        return StateWait(self._view, state, timeout_s, self._actor.actor_inbox)

    @property
    def running(self) -> tuple[Running, ...]:
        """The commands under way on this robot, whoever gave them; without those that end within an instant.

        Of a remote robot it is what the robot has told: a command is listed when it has run for some 0.1 to 0.3 s, and
        its progress is at most as old. Nothing is listed while the robot is out of reach.
        """
        return self._actor.running()

    @property
    def problems(self) -> tuple[EALError, ...]:
        """What kept plugins out, or made the robot fail."""
        return self._view.problems

    @property
    def restarts(self) -> Mapping[str, int]:
        """How often each resource was restarted."""
        return dict(self._view.restarts)

    @property
    def not_ready(self) -> Mapping[str, str]:
        """Why resources are not ready, by their names: their devices are absent, and are tried again.

        Of a remote robot it is what the robot told when it was connected, or in its answer to the last ping.
        """
        return dict(self._view.not_ready)

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

    @property
    def controller_id(self) -> str | None:
        """What the robot knows this process by, as in `Ping.holder_ids`; None for a robot of this process."""
        return self._view.controller_id

    def release(self, *resources: str) -> Future[None]:
        """Let go of resources that this process has commanded, so that another controller may at once.

        Without it they are free when the fleet is closed. What goes on there by our commands is halted; what is
        commanded later takes the resource anew. Nothing happens to resources that others hold, or nobody does, as
        within one process.

        Args:
            resources: their names; all of the robot's if there are none.

        Thread: any; does not block.
        """
        return self._actor.release(resources or tuple(self))

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
        return UnavailableError(self._last_problem("has not started yet"), robot=self.name)

    def _failed(self) -> RobotFailedError:
        return RobotFailedError(self._last_problem("has failed"), robot=self.name)

    def _last_problem(self, otherwise: str) -> str:
        problems = self.problems  # read once: a robot that comes back has none
        return problems[-1].message if problems else otherwise

    def close(self, timeout_s: float = CLOSE_TIMEOUT_S) -> None:
        """Halt every resource, disconnect the plugins, end every thread; see close_all."""
        close_robots([self], timeout_s)


def close_robots(robots: Sequence[RobotHandle], timeout_s: float = CLOSE_TIMEOUT_S) -> None:
    """Halt every resource, disconnect the plugins, end every thread, of all robots at once; see close_all."""
    close_all([(robot._actor, robot._view) for robot in robots], timeout_s)
