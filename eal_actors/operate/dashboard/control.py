"""ControlRegistry: which browser or scenario of the dashboard controls which resource.

Robots on the network reserve a resource for the controller that commands it. The dashboard releases a resource IDLE_S
after its last command there, so that other controllers can use it.

A scenario and a hand that drives would end each other's commands in turn. So the one that comes later is refused.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import ResourceBusyError
from eal_actors.kernel.log import get_logger
from eal_actors.operate.dashboard.state_store import CurrentSteps, StateStore

IDLE_S: Final = 2.0
"""Real seconds from the end of the last command to the release of its resource."""
WHOLE: Final = ""
"""In place of a resource: the whole robot, because a scenario may command all of its resources."""


@dataclass(slots=True)
class _Use:
    """The current commands of one resource, and the user who gave the newest."""

    by: str
    count: int = 0
    ended_s: float = 0.0


class ControlRegistry:
    """Counts the current commands of each resource, by browser or scenario.

    Callers `acquire` a resource before a command and call `done` at its end; hands `drive` and `undrive`. So a release
    cannot overtake a command: it is sent before the command, or not at all. Thread: any; never blocks.
    """

    def __init__(self, clock: Clock = REAL_TIME) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._uses: dict[tuple[str, str], _Use] = {}
        self._driven: set[str] = set()

    def acquire(self, robot: str, resource: str, by: str) -> None:
        """Record that a command to a resource, or to WHOLE, is about to start.

        Raises ResourceBusyError for WHOLE if the robot is driven by hand.
        """
        with self._lock:
            if resource == WHOLE and robot in self._driven:
                raise ResourceBusyError(f"it is driven by hand: release the keys to start {by}", robot=robot)
            self._count(robot, resource, by)

    def drive(self, robot: str, resource: str, by: str) -> None:
        """Record that a hand is about to drive a robot until `undrive`.

        Raises ResourceBusyError if a scenario commands the robot.
        """
        with self._lock:
            whole = self._uses.get((robot, WHOLE))
            if whole is not None and whole.count > 0:
                raise ResourceBusyError(f"{whole.by} commands it: abort the scenario to drive by hand", robot=robot)
            self._count(robot, resource, by)
            self._driven.add(robot)

    def _count(self, robot: str, resource: str, by: str) -> None:
        use = self._uses.setdefault((robot, resource), _Use(by))
        use.by = by
        use.count += 1

    def undrive(self, robot: str, resource: str) -> None:
        """Record that a hand has ceased to drive a robot."""
        with self._lock:
            self._driven.discard(robot)
        self.done(robot, resource)

    def done(self, robot: str, resource: str) -> None:
        """Record the end of a command."""
        with self._lock:
            use = self._uses[robot, resource]
            use.count -= 1
            use.ended_s = self._clock.now()

    def users(self, robot: str) -> dict[str, str]:
        """Return the controllers of the robot's resources, now or within IDLE_S, by resource or WHOLE."""
        with self._lock:
            return {name: use.by for (owner, name), use in self._uses.items() if owner == robot and self._is_fresh(use)}

    def by(self, robot: str, resource: str) -> str | None:
        """Return the last controller of a resource; None if the dashboard has never commanded it."""
        with self._lock:
            uses = [use for name in (resource, WHOLE) if (use := self._uses.get((robot, name))) is not None]
            return max(uses, key=lambda use: (use.count > 0, use.ended_s)).by if uses else None

    def release_idle(self, robot: RobotHandle, held: Iterable[str]) -> None:
        """Release the held resources without a controller here. Does not wait for the robot."""
        with self._lock:
            if self._is_used(robot.name, WHOLE):
                return
            idle = [resource for resource in held if not self._is_used(robot.name, resource)]
            if idle:
                robot.release(*idle).add_done_callback(lambda done: _log_failure(robot.name, done))

    def _is_used(self, robot: str, resource: str) -> bool:
        use = self._uses.get((robot, resource))
        return use is not None and self._is_fresh(use)

    def _is_fresh(self, use: _Use) -> bool:
        return use.count > 0 or self._clock.now() < use.ended_s + IDLE_S


def _log_failure(robot: str, released: Future[None]) -> None:
    if (error := released.exception()) is not None:  # retried as long as the robot reports the resource as held by us
        get_logger(robot=robot).debug("resources could not be released", reason=str(error))


class DashboardContext(NamedTuple):
    """The objects that the parts of one dashboard share."""

    fleet: Fleet
    store: StateStore
    steps: CurrentSteps
    control: ControlRegistry
