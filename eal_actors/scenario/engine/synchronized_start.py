"""Synchronized starts: all robots of an `on` meet, agree on a time, and begin a command at it."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any, Final

from eal_actors.actors.call import Call
from eal_actors.actors.future import Future
from eal_actors.facade.synchronized_start import DelayMeter, skew
from eal_actors.kernel.errors import CallCancelledError, DeadlineError
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.frames import ExecutionContext, Participant, StepTask
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.scenario import Step
from eal_actors.scenario.report.events import StartedTogether
from eal_actors.scenario.report.summary import StartReport

_LEAD_S: Final = 0.002
"""Real seconds between the last sending and the start, in addition to the delay of the network."""
_LEAD_EACH_S: Final = 0.0002
"""Maximum real seconds to send one command."""
_PINGS: Final = 3
_MEET_S: Final = 600.0
"""Seconds of the fleet's clock that a robot waits for the others: they may wait for it in another step."""


class SynchronizedStart:
    """One start of several robots at the same time. `agreed` is done when the time is agreed."""

    def __init__(self, run: RunContext, path: str, tasks: Sequence[StepTask]) -> None:
        self.agreed: Future[None] = Future(run.clock)
        self._run = run
        self._path = path
        self._start_s = 0.0
        self._calls: dict[str, Call[Any] | None] = {}
        self._left = len(tasks)
        self._robots = [task.slot.robot for task in tasks if task.slot is not None]

    def agree(self) -> Coroutine:
        """Measure the delays to the robots, and agree on a time."""
        clock = self._run.clock
        meter = DelayMeter([robot.handle for robot in self._robots])
        for _ in range(_PINGS):
            pings = meter.ping()
            late = [ping for ping in pings if not ping.done()]
            if late:
                yield from self._wait(late, clock.of_real(meter.TIMEOUT_S))
            if not meter.record(pings) or not late:
                break
        delay_s = clock.of_real(meter.longest_s) + max(
            (resource.link.delay_s for robot in self._robots for resource in robot.handle.values()), default=0.0
        )
        lead_s = clock.of_real(_LEAD_S + _LEAD_EACH_S * len(self._robots))
        self._start_s = clock.now() + lead_s + delay_s
        self.agreed.set()

    def _wait(self, futures: Sequence[Future[Any]], timeout_s: float) -> Coroutine:
        """Wait until all futures are done, or the time is up."""
        limit = self._run.loop.sleep(timeout_s)
        for future in futures:
            either: Future[None] = Future(self._run.clock)
            future.add_done_callback(lambda _, done=either: done.set())  # type: ignore[misc]
            limit.add_done_callback(lambda _, done=either: done.set())  # type: ignore[misc]
            yield either

    def begin(
        self, method: Callable[..., Future[Any]], fields: Mapping[str, Any], timeout_s: float | None
    ) -> Future[Any]:
        """Send a robot's command, which begins at the agreed time."""
        ahead_s = max(0.0, self._start_s - self._run.clock.now())
        limit_s = None if timeout_s is None else timeout_s + ahead_s
        return method(**fields, timeout_s=limit_s, at_s=self._start_s)

    def end(self, robot: Participant, call: Call[Any] | None) -> float:
        """Record the end of a robot's command; the last one reports the start.

        Return the begin, in seconds since the run's start; the agreed time, if the begin is unknown.
        """
        self._calls[robot.name] = call
        self._left -= 1
        if self._left == 0:
            self._report()
        began_s = call.began_s if call is not None and call.began_s is not None else self._start_s
        return began_s - self._run.zero_s

    def _report(self) -> None:
        run, zero_s = self._run, self._run.zero_s
        begins = {
            name: None if call is None or call.began_s is None else call.began_s - zero_s
            for name, call in self._calls.items()
        }
        errors = [call.began_error_s for call in self._calls.values() if call is not None]
        skew_s, skew_error_s = skew(list(begins.values()), errors)
        report = StartReport(
            step=self._path, start_s=self._start_s - zero_s, skew_s=skew_s, skew_error_s=skew_error_s, begins=begins
        )
        run.starts.append(report)
        run.emit(lambda time_s: StartedTogether(time_s, report))


def join_start(
    run: RunContext, context: ExecutionContext, step: Step, path: str
) -> Generator[Future[Any], None, SynchronizedStart | None]:
    """Meet the other robots of the `on`, and agree on a time; None in `finally`, where robots do not meet.

    Raises CallCancelledError if the run, the task or the robot was stopped, and DeadlineError if others do not come.
    """
    if context.is_finally:
        return None
    key, task = step.meeting(context.frame), context.task
    meeting = run.barriers.arrive(key, task)
    try:
        is_met = yield from run.wait_within(context, meeting, _MEET_S)
    finally:
        run.barriers.withdraw(key, task)
    if not is_met:
        raise DeadlineError(
            f"{run.barriers.missing(key, task)} did not come to this step with `together` within {_MEET_S:g} s: "
            "all robots must begin by the same step"
        )
    met = meeting.get()
    start: SynchronizedStart | None = met.agreement
    if start is None:
        start = met.agreement = SynchronizedStart(run, path, met.tasks)
        run.loop.spawn(start.agree(), lambda error: run.fail(error) if error is not None else None)
    agreed: Future[None] = Future(run.clock)  # its own, which a stop of this robot alone may cancel
    start.agreed.add_done_callback(lambda _: agreed.set())
    try:
        yield from run.wait(context, agreed)
        agreed.get()
    except CallCancelledError:
        if context.robot is not None:
            start.end(context.robot, None)
        raise
    return start
