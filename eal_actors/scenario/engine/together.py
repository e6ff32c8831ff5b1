"""Starts at the same time: all robots of an `on` meet, agree on a time, and begin a command at it."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any, Final

from eal_actors.actors.call import Call
from eal_actors.actors.future import Future
from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.errors import CallCancelledError
from eal_actors.scenario.engine.cast import Context, RobotRun, Task
from eal_actors.scenario.engine.loop import Branch
from eal_actors.scenario.engine.meetings import meeting_key
from eal_actors.scenario.engine.stage import Stage
from eal_actors.scenario.events import StartedTogether
from eal_actors.scenario.model import CallStep
from eal_actors.scenario.report import StartReport

_LEAD_S: Final = 0.002
"""Real seconds between the last sending and the start, beside what the ways to the robots take."""
_LEAD_EACH_S: Final = 0.0002
"""Real seconds that sending one command takes at most."""
_PINGS: Final = 3
_PINGING_S: Final = 0.5


class Start:
    """One start of several robots at the same time.

    Args:
        stage: the run.
        path: the step's path.
        tasks: those who met.

    Attributes:
        agreed: done when the time is agreed on.
    """

    def __init__(self, stage: Stage, path: str, tasks: Sequence[Task]) -> None:
        self.agreed: Future[None] = Future(stage.clock)
        self._stage = stage
        self._path = path
        self._start_s = 0.0
        self._calls: dict[str, Call[Any] | None] = {}
        self._left = len(tasks)
        self._robots = [task.seat.robot for task in tasks if task.seat is not None]

    def agree(self) -> Branch:
        """Find out how long the ways to the robots are, and agree on a time."""
        clock = self._stage.clock
        way_s = yield from self._longest_way_s()
        way_s = clock.of_real(way_s) + max(
            (resource.link.delay_s for robot in self._robots for resource in robot.handle.values()), default=0.0
        )
        lead_s = clock.of_real(_LEAD_S + _LEAD_EACH_S * len(self._robots))
        self._start_s = clock.now() + lead_s + way_s
        self.agreed.set()

    def _longest_way_s(self) -> Generator[Future[Any], None, float]:
        """Return the longest round trip, with what the offset of that clock may be wrong by; in real seconds."""
        clock, longest_s = self._stage.clock, 0.0
        for _ in range(_PINGS):
            pings = [robot.handle.ping() for robot in self._robots if robot.handle.state is RobotState.READY]
            late = [ping for ping in pings if not ping.done()]
            if late:
                limit = self._stage.loop.sleep(clock.of_real(_PINGING_S))
                for ping in late:
                    either: Future[None] = Future(clock)
                    ping.add_done_callback(lambda _, done=either: done.set())  # type: ignore[misc]
                    limit.add_done_callback(lambda _, done=either: done.set())  # type: ignore[misc]
                    yield either
            told = [ping.get() for ping in pings if ping.done() and ping.exception() is None]
            longest_s = max([longest_s, *(ping.round_trip_s + ping.offset_error_s for ping in told)])
            if not late:
                break
            if any(not ping.done() for ping in late):
                return max(longest_s, _PINGING_S)
        return longest_s

    def begin(
        self, method: Callable[..., Future[Any]], fields: Mapping[str, Any], timeout_s: float | None
    ) -> Future[Any]:
        """Send a robot's command, which begins at the agreed time."""
        ahead_s = max(0.0, self._start_s - self._stage.clock.now())
        limit_s = None if timeout_s is None else timeout_s + ahead_s
        return method(**fields, timeout_s=limit_s, at_s=self._start_s)

    def end(self, robot: RobotRun, call: Call[Any] | None) -> float:
        """Note that a robot's command is over; the last one tells how close together they began.

        Returns:
            When it began, in seconds since the run's start; the time agreed on, if nobody heard of it.
        """
        self._calls[robot.name] = call
        self._left -= 1
        if self._left == 0:
            self._tell()
        began_s = call.began_s if call is not None and call.began_s is not None else self._start_s
        return began_s - self._stage.zero_s

    def _tell(self) -> None:
        stage, zero_s = self._stage, self._stage.zero_s
        begins = {
            name: None if call is None or call.began_s is None else call.began_s - zero_s
            for name, call in self._calls.items()
        }
        times = [began_s for began_s in begins.values() if began_s is not None]
        errors = sorted(call.began_error_s for call in self._calls.values() if call is not None)
        report = StartReport(
            step=self._path,
            start_s=self._start_s - zero_s,
            skew_s=max(times) - min(times) if times and len(times) == len(begins) else None,
            skew_error_s=sum(errors[-2:]),
            begins=begins,
        )
        stage.starts.append(report)
        stage.tell(lambda time_s: StartedTogether(time_s, report))


def join_start(stage: Stage, context: Context, step: CallStep, path: str) -> Generator[Future[Any], None, Start | None]:
    """Meet the others of the `on`, and agree with them on a time; None in `finally`, where nobody waits for others.

    Raises:
        CallCancelledError: the run, the line or the robot was stopped.
    """
    if context.is_finally:
        return None
    key, task = meeting_key(context.unit, step), context.task
    meeting = stage.meetings.arrive(key, task)
    try:
        yield from stage.wait(context, meeting)
        met = meeting.get()
    except CallCancelledError:
        stage.meetings.withdraw(key, task)
        raise
    start: Start | None = met.outcome
    if start is None:
        start = met.outcome = Start(stage, path, met.tasks)
        stage.loop.spawn(start.agree(), lambda error: stage.fail(error) if error is not None else None)
    try:
        yield from stage.wait(context, start.agreed)
        start.agreed.get()
    except CallCancelledError:
        if context.robot is not None:
            start.end(context.robot, None)
        raise
    return start
