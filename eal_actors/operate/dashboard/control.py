"""Control: who of the dashboard commands what; what nobody commands any more is free for other controllers."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.log import get_logger

IDLE_S: Final = 2.0
"""Real seconds after the last command's end until its resource is let go."""
WHOLE: Final = ""
"""In place of a resource: all of the robot's, as a scenario may command any of them."""


@dataclass(slots=True)
class _Use:
    """The commands of one resource that are under way, and whose the last of them is."""

    by: str
    count: int = 0
    ended_s: float = 0.0


class Control:
    """Keeps who commands what from here.

    Whoever is about to command says `take` before, and `done` when the command has ended. So what is let go cannot
    overtake a command: it was sent before, or it is not sent.

    Args:
        clock: counts IDLE_S.

    Thread: any; never blocks.
    """

    def __init__(self, clock: Clock = REAL_TIME) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._uses: dict[tuple[str, str], _Use] = {}

    def take(self, robot: str, resource: str, by: str) -> None:
        """Note that somebody is about to command a resource, or WHOLE for any of the robot's."""
        with self._lock:
            use = self._uses.setdefault((robot, resource), _Use(by))
            use.by = by
            use.count += 1

    def done(self, robot: str, resource: str) -> None:
        """Note that a command has ended."""
        with self._lock:
            use = self._uses[robot, resource]
            use.count -= 1
            use.ended_s = self._clock.now()

    def users(self, robot: str) -> dict[str, str]:
        """Return who commands the robot's resources now, or did within IDLE_S, by their names or WHOLE."""
        with self._lock:
            return {name: use.by for (owner, name), use in self._uses.items() if owner == robot and self._is_fresh(use)}

    def by(self, robot: str, resource: str) -> str | None:
        """Return who commanded a resource last; None if nobody did from here."""
        with self._lock:
            uses = [use for name in (resource, WHOLE) if (use := self._uses.get((robot, name))) is not None]
            return max(uses, key=lambda use: (use.count > 0, use.ended_s)).by if uses else None

    def let_go(self, robot: RobotHandle, held: Iterable[str]) -> None:
        """Let go of those of the held resources that nobody here commands any more. Does not wait for the robot."""
        with self._lock:
            if self._is_used(robot.name, WHOLE):
                return
            idle = [resource for resource in held if not self._is_used(robot.name, resource)]
            if idle:
                robot.release(*idle).add_done_callback(lambda done: _tell_unreleased(robot.name, done))

    def _is_used(self, robot: str, resource: str) -> bool:
        use = self._uses.get((robot, resource))
        return use is not None and self._is_fresh(use)

    def _is_fresh(self, use: _Use) -> bool:
        return use.count > 0 or self._clock.now() < use.ended_s + IDLE_S


def _tell_unreleased(robot: str, released: Future[None]) -> None:
    error = released.exception()
    if error is not None:  # it is tried again, as long as the robot says that we hold something
        get_logger(robot=robot).debug("resources could not be let go", reason=str(error))
