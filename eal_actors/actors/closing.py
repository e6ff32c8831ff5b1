"""Closing robots: all at once, and whatever state they are in."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Final, TypeAlias

from eal_actors.actors.robot_view import RobotConnection, RobotView
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import UnavailableError, WaitTimeoutError
from eal_actors.kernel.log import get_logger

CLOSE_TIMEOUT_S: Final = 5.0
"""How long (real time) a robot has to stop by itself before what is stuck is abandoned."""

Connected: TypeAlias = tuple[RobotConnection, RobotView]


def close_all(robots: Sequence[Connected], timeout_s: float = CLOSE_TIMEOUT_S) -> None:
    """Halt every resource, disconnect the plugins, end every thread, of all robots at once.

    What is stuck is abandoned, and named in the log.

    Args:
        robots: the robots.
        timeout_s: real seconds for them to stop by themselves.

    Thread: blocks the caller, at most about twice `timeout_s` however many robots there are. In a thread of one of the
    robots, such as a done-callback's, it does not wait for that robot.
    """
    for actor, _ in robots:  # before time may go on without this thread, or motions would end that are to be stopped
        actor.shut_down()
    with contextlib.ExitStack() as stack:
        for clock in dict.fromkeys(view.clock for _, view in robots):
            stack.enter_context(clock.outside())
        _close_all(robots, timeout_s)


def _close_all(robots: Sequence[Connected], timeout_s: float) -> None:
    waiting = [(actor, view) for actor, view in robots if not actor.is_at_work()]
    late = _not_stopped(waiting, timeout_s)
    for actor, _ in late:
        actor.force_down()
    for actor, _ in _not_stopped(late, timeout_s / 2):
        actor.abandon(UnavailableError("the robot was stuck while it was closed"))
    end_s = REAL_TIME.now() + timeout_s / 2
    for actor, view in waiting:
        if alive := actor.join(end_s - REAL_TIME.now()):
            get_logger(robot=view.name).error("threads are stuck and were left behind", threads=alive)


def _not_stopped(robots: Sequence[Connected], timeout_s: float) -> list[Connected]:
    """Wait for robots to stop; return those that have not."""
    end_s = REAL_TIME.now() + timeout_s
    late = []
    for actor, view in robots:
        try:
            view.stopped.get(timeout=max(0.0, end_s - REAL_TIME.now()))
        except WaitTimeoutError:
            late.append((actor, view))
    return late
