"""Closing robots: all at once, and whatever state they are in."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from eal_actors.clock import REAL_TIME
from eal_actors.errors import UnavailableError, WaitTimeoutError
from eal_actors.log import get_logger

if TYPE_CHECKING:
    from eal_actors.actors.handles import RobotHandle

CLOSE_TIMEOUT_S: Final = 5.0
"""How long (real time) a robot has to stop by itself before what is stuck is abandoned."""


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
