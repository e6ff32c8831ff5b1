"""A robot's row in the table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import MailboxLoad, Ping, RunningCommand
from eal_actors.operate.top.call_statistics import CallStatistics, RecentCalls


@dataclass(frozen=True, slots=True)
class TableRow:
    """The state of a robot.

    Attributes:
        state: its life-cycle state; `STOP` during an emergency stop.
        waiting: calls in its mailboxes; None if not known yet.
        oldest_s: the waiting time of the oldest call, by the fleet's clock.
        statistics: of this process's calls; the latencies of pings for a remote robot without calls.
        restarts: of all its resources; None if not known yet.
    """

    name: str
    state: str
    is_remote: bool
    waiting: int | None
    oldest_s: float
    statistics: CallStatistics
    restarts: int | None
    running: tuple[RunningCommand, ...]
    notes: tuple[str, ...]


def robot_row(robot: RobotHandle, calls: RecentCalls, pings: RecentCalls, ping: Ping | None) -> TableRow:
    """Return a robot's row, where `ping` is its last answer, if there is one. Thread: any; does not block."""
    mailboxes = _mailboxes(robot, ping)
    restarts = robot.restarts if not robot.is_remote else None if ping is None else ping.restarts
    return TableRow(
        name=robot.name,
        state=robot.state.value if robot.stopped_because is None else "STOP",
        is_remote=robot.is_remote,
        waiting=None if mailboxes is None else sum(waiting.count for waiting in mailboxes),
        oldest_s=max((waiting.oldest_s for waiting in mailboxes or ()), default=0.0),
        statistics=_statistics(robot, calls, pings),
        restarts=None if restarts is None else sum(restarts.values()),
        running=robot.running,
        notes=tuple(_notes(robot, ping)),
    )


def _statistics(robot: RobotHandle, calls: RecentCalls, pings: RecentCalls) -> CallStatistics:
    now_s = robot.clock.now()
    statistics = calls.statistics(robot.name, now_s)
    if not robot.is_remote or statistics.p50_s is not None:
        return statistics
    of_pings = pings.statistics(robot.name, now_s)
    return CallStatistics(statistics.calls_per_s, of_pings.p50_s, of_pings.p99_s)


def _notes(robot: RobotHandle, ping: Ping | None) -> Iterator[str]:
    if robot.stopped_because is not None:
        yield f"emergency stop: {robot.stopped_because}"
        if not robot.is_stop_confirmed:
            yield "the stop is NOT CONFIRMED: the robot may still move"
    for problem in robot.problems:
        yield problem.message
    for name, reason in robot.not_ready.items():
        yield f"{name} is not ready: {reason}"
    if ping is not None:
        yield from ping.warnings
        for name, holder in ping.holders.items():
            yield f"{name} is held by {holder}"


def _mailboxes(robot: RobotHandle, ping: Ping | None) -> list[MailboxLoad] | None:
    """Return the waiting calls by the fleet's clock; None if a remote robot has not reported them yet."""
    if not robot.is_remote:
        return [waiting for handle in robot.values() if (waiting := handle.waiting) is not None]
    if ping is None:
        return None
    of_real = robot.clock.of_real
    return [MailboxLoad(waiting.count, of_real(waiting.oldest_s)) for waiting in ping.mailboxes.values()]
