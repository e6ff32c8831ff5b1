"""Synchronized start: commands of many robots that begin at the same time, and the record of their begins."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from eal_actors.actors.call import Call
from eal_actors.actors.combine import gather
from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.actors.robot_view import Ping, RobotState
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import ArgumentError, WaitTimeoutError

Command: TypeAlias = str | tuple[str, Any]
"""A command, or a command and its argument."""

_PINGS: Final = 5


@dataclass(frozen=True, slots=True)
class CommandBegin:
    """The begin of one command.

    `began_s` is the time of this process's fleet clock; None if the command did not begin, or its begin is unknown.
    `error_s` is the maximum error of `began_s` in seconds; 0 for a robot of this process.
    """

    robot: str
    resource: str
    command: str
    began_s: float | None
    error_s: float


@dataclass(frozen=True, slots=True)
class StartRecord:
    """The begins of commands with a common start. `start_s` is the planned time of the fleet's clock."""

    start_s: float
    begins: tuple[CommandBegin, ...]

    @property
    def skew_s(self) -> float | None:
        """Seconds from the first begin to the last; None if a begin is missing."""
        return skew([begin.began_s for begin in self.begins], ())[0]

    @property
    def skew_error_s(self) -> float:
        """The maximum error of `skew_s` in seconds."""
        return skew((), (begin.error_s for begin in self.begins))[1]


@dataclass(frozen=True, slots=True)
class SynchronizedCommands:
    """Commands with a common start.

    `start_s` is the planned time of the fleet's clock. `record` is done when the last command has succeeded or failed.
    """

    start_s: float
    futures: tuple[Future[int], ...]
    record: Future[StartRecord]


def send_synchronized(
    commands: Mapping[ResourceHandle, Command],
    robots: Iterable[RobotHandle],
    clock: Clock,
    lead_s: float,
    timeout_s: float | None,
) -> SynchronizedCommands:
    """Send commands to begin at the same time, with the arguments of `Fleet.together`."""
    if not (math.isfinite(lead_s) and lead_s >= 0):
        raise ArgumentError(f"lead_s must be seconds, at least 0, not {lead_s!r}")
    delay_s = clock.of_real(_longest_delay_s(robots, clock))
    delay_s += max((handle.link.delay_s for handle in commands), default=0.0)
    start_s = clock.now() + lead_s + delay_s
    calls: list[tuple[ResourceHandle, str, Future[int]]] = []
    try:
        for handle, wanted in commands.items():
            command, data = (wanted, None) if isinstance(wanted, str) else wanted
            calls.append((handle, command, handle.send_cmd(command, data, timeout_s=timeout_s, at_s=start_s)))
    except BaseException:  # such as a value that cannot be sent: nobody would hear of those that were
        for _, _, call in calls:
            call.cancel()
        raise
    futures = tuple(call for _, _, call in calls)
    ended = gather(futures, return_exceptions=True)
    record = ended.map(lambda _: StartRecord(start_s, tuple(_begin_of(*call) for call in calls)))
    return SynchronizedCommands(start_s, futures, record)


class DelayMeter:
    """Measures the longest delay to some robots by pings; the caller waits for them.

    `longest_s` is the longest round trip so far, in real seconds, with the maximum error of the clock offset.
    """

    TIMEOUT_S: Final = 0.5
    """Real seconds to wait for the answers."""

    def __init__(self, robots: Iterable[RobotHandle]) -> None:
        self.longest_s = 0.0
        self._robots = list(robots)

    def ping(self) -> list[Future[Ping]]:
        """Ping every robot that is ready."""
        return [robot.ping() for robot in self._robots if robot.state is RobotState.READY]

    def record(self, pings: Sequence[Future[Ping]]) -> bool:
        """Record the answers; return whether all pings are done. Missing answers count as the timeout."""
        answers = [ping.get() for ping in pings if ping.done() and ping.exception() is None]
        self.longest_s = max([self.longest_s, *(ping.round_trip_s + ping.offset_error_s for ping in answers)])
        is_complete = all(ping.done() for ping in pings)
        if not is_complete:
            self.longest_s = max(self.longest_s, self.TIMEOUT_S)
        return is_complete


def _longest_delay_s(robots: Iterable[RobotHandle], clock: Clock) -> float:
    meter = DelayMeter(robots)
    end_s = REAL_TIME.now() + meter.TIMEOUT_S
    for _ in range(_PINGS):
        pings = meter.ping()
        if not all(ping.done() for ping in pings):
            with clock.outside(), suppress(WaitTimeoutError):
                gather(pings, return_exceptions=True).get(timeout=max(0.0, end_s - REAL_TIME.now()))
        if not meter.record(pings):
            break
    return meter.longest_s


def skew(begins: Sequence[float | None], errors: Iterable[float]) -> tuple[float | None, float]:
    """Return the time from the first begin to the last, or None if one is missing, and its maximum error."""
    times = [begin for begin in begins if begin is not None]
    return max(times) - min(times) if times and len(times) == len(begins) else None, sum(sorted(errors)[-2:])


def _begin_of(handle: ResourceHandle, command: str, future: Future[int]) -> CommandBegin:
    began_s, error_s = (future.began_s, future.began_error_s) if isinstance(future, Call) else (None, 0.0)
    return CommandBegin(handle.robot, handle.name, command, began_s, error_s)
