"""One look at a fleet: what the screen shows of each robot."""

from __future__ import annotations

from dataclasses import dataclass

from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import Ping
from eal_actors.actors.running import Running
from eal_actors.actors.waiting import Waiting
from eal_actors.operate.top.call_statistics import CallStatistics, RecentCalls


@dataclass(frozen=True, slots=True)
class RobotRow:
    """What is known of a robot.

    Attributes:
        name: the robot's name.
        state: where it is in its life, or `stopped` by whom an emergency stop holds it.
        is_remote: whether it is in another process.
        waiting: calls in its mailboxes; None where that is not known yet.
        oldest_s: how long the oldest of them waits, by the fleet's clock.
        figures: of this process's calls; of a remote robot's pings where there are none.
        restarts: of all its resources; None where that is not known yet.
        running: the commands under way, whoever gave them.
        notes: what is wrong with it, in words.
    """

    name: str
    state: str
    is_remote: bool
    waiting: int | None
    oldest_s: float
    figures: CallStatistics
    restarts: int | None
    running: tuple[Running, ...]
    notes: tuple[str, ...]


def robot_row(robot: RobotHandle, calls: RecentCalls, pings: RecentCalls, ping: Ping | None) -> RobotRow:
    """Return what is known of a robot now. Thread: any; does not block.

    Args:
        robot: the robot.
        calls: what this process's calls took.
        pings: what pings took.
        ping: its last answer, if it gave one.
    """
    now_s = robot.clock.now()
    waits = _mailboxes(robot, ping)
    restarts = robot.restarts if not robot.is_remote else None if ping is None else ping.restarts
    figures = calls.figures(robot.name, now_s)
    if robot.is_remote and figures.p50_s is None:
        of_pings = pings.figures(robot.name, now_s)
        figures = CallStatistics(figures.calls_per_s, of_pings.p50_s, of_pings.p99_s)
    because = robot.stopped_because
    notes = [f"emergency stop: {because}"] if because is not None else []
    notes += [problem.message for problem in robot.problems]
    notes += [f"{name} is not ready: {reason}" for name, reason in robot.not_ready.items()]
    if ping is not None:
        notes += [f"{name} is held by {holder}" for name, holder in ping.holders.items()]
    return RobotRow(
        name=robot.name,
        state=robot.state.value if because is None else "STOP",
        is_remote=robot.is_remote,
        waiting=None if waits is None else sum(waiting.count for waiting in waits),
        oldest_s=max((waiting.oldest_s for waiting in waits or ()), default=0.0),
        figures=figures,
        restarts=None if restarts is None else sum(restarts.values()),
        running=robot.running,
        notes=tuple(notes),
    )


def _mailboxes(robot: RobotHandle, ping: Ping | None) -> list[Waiting] | None:
    """Return what waits for the robot, by the fleet's clock: here, or as it told itself; None if it did not yet."""
    if not robot.is_remote:
        return [waiting for handle in robot.values() if (waiting := handle.waiting) is not None]
    if ping is None:
        return None
    of_real = robot.clock.of_real
    return [Waiting(waiting.count, of_real(waiting.oldest_s)) for waiting in ping.mailboxes.values()]
