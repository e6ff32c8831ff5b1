"""Runs a plan on a fleet, in one thread however many robots there are."""

from __future__ import annotations

import enum
import threading
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Final

from eal_actors.actors.future import Future
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel import spans
from eal_actors.kernel.clock import REAL_TIME, ScaledClock, wall_time
from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.lock_step import LockStepClock, Rate
from eal_actors.kernel.log import get_logger
from eal_actors.scenario.engine.cast import RobotRun
from eal_actors.scenario.engine.checkpoints import checkpoint, restore, seat_robots, tell_lost
from eal_actors.scenario.engine.loop import Branch, Loop
from eal_actors.scenario.engine.outcomes import end_robots, report_robot, variables_of_run
from eal_actors.scenario.engine.performer import Performer
from eal_actors.scenario.engine.stage import Stage
from eal_actors.scenario.events import Event, RunContinued, RunEnded, RunStarted
from eal_actors.scenario.files import image_writer
from eal_actors.scenario.journal import Journal, Listener
from eal_actors.scenario.plan import Plan
from eal_actors.scenario.records import to_record
from eal_actors.scenario.report import ErrorReport, Report, RunOutcome
from eal_actors.scenario.resuming import Resumption, keeps_checkpoints, scenario_hash
from eal_actors.scenario.saves import saves_files

_THREADS_END_S: Final = 0.5
"""Real seconds in which the functions of Python steps may come to their end when the run has."""


class _Phase(enum.Enum):
    STEPS = enum.auto()
    FINALLY = enum.auto()
    HALTS = enum.auto()


class _RunFuture(Future[Report]):
    """The report to come; cancelling it aborts the run."""

    def __init__(self, run: Run, fleet: Fleet) -> None:
        super().__init__(fleet.clock)
        self._run_of = run

    def describe(self) -> str:
        return "a scenario's report"

    def _given_up(self) -> None:
        self._run_of.abort("its future was cancelled")


class Run:
    """One run of a scenario.

    The steps come first. Then, whatever happened, come the steps of `finally`, and after them every actuator of every
    robot is halted. A run that is stopped early halts them before `finally` as well.

    Args:
        plan: what to do, as `make_plan` returned it for this fleet.
        fleet: the connected fleet.
        directory: the run's folder: `summary.json`, `events.jsonl`, and a folder of saved answers for each robot.
            None keeps nothing.
        listeners: called with each event, in the run's own thread; they must not block.
        resumption: where a run that was cut off goes on, as `read_run` returned it; `directory` is its folder.

    Raises:
        ScenarioError: the scenario saves files, and there is no directory; or the run cannot go on.
    """

    def __init__(
        self,
        plan: Plan,
        fleet: Fleet,
        directory: Path | None = None,
        listeners: Sequence[Listener] = (),
        resumption: Resumption | None = None,
    ) -> None:
        self._plan = plan
        self._fleet = fleet
        self._directory = directory
        self._listeners = listeners
        self._resumption = resumption
        self._saves = saves_files(plan.scenario)
        if self._saves and directory is None:
            raise ScenarioError(f"scenario {plan.scenario.name!r} saves files, so its run needs a directory")
        if resumption is not None:
            resumption.require_safe(plan.scenario)
        self._loop = Loop(fleet.clock)
        self._robots = {name: RobotRun(fleet[name]) for name in plan.robots}
        self._stage = Stage(plan, self._robots, self._loop, fleet.config.seed, directory, self._tell, self._fail)
        self._performer = Performer(self._stage)
        self._future = _RunFuture(self, fleet)
        self._phase = _Phase.STEPS
        self._abort_reasons: list[str] = []
        self._error: BaseException | None = None
        self._is_aborted = False
        self._is_started = False
        self._is_over = False
        self._started: datetime | None = None

    def start(self) -> Future[Report]:
        """Begin; the future is done when everything is over, with success whatever the run's outcome.

        Raises:
            ScenarioError: it was started before, or the directory cannot be written or holds a run already.

        Thread: any, once; does not block.
        """
        if self._is_started:
            raise ScenarioError("this run was started already; a run is for once")
        self._is_started = True
        self._journal = Journal(self._directory, self._listeners, goes_on=self._resumption is not None)
        if self._saves:
            image_writer()  # its import takes long, which would hold up the robots
        before_s = self._resumption.time_s if self._resumption is not None else 0.0
        self._started, self._stage.zero_s = wall_time(), self._fleet.clock.now() - before_s
        name = f"scenario {self._plan.scenario.name}"
        self._fleet.clock.start(threading.Thread(target=self._run, name=name, daemon=True))
        return self._future

    @property
    def start_s(self) -> float:
        """When it began, in seconds of the fleet's clock: its events and records count from there.

        Raises:
            ScenarioError: it was not started.
        """
        if self._started is None:
            raise ScenarioError("this run was not started")
        return self._stage.zero_s

    # Control.

    def abort(self, reason: str) -> None:
        """Stop the robots and go to `finally`; called again, it skips the rest of `finally`, but not the halts.

        Thread: any, signal handlers too; never blocks, takes no lock.
        """
        self._abort_reasons.append(reason)
        self._loop.post(self._heed_aborts)

    def pause(self) -> None:
        """Begin nothing new; what is under way goes on to its end. Time-outs of meetings and waits stand still.

        Harmless if the run is paused, and once its steps are over. Thread: any; never blocks.
        """
        self._loop.post(lambda: self._control(self._stage.pace.pause))

    def resume(self) -> None:
        """Go on after a pause; harmless without one. Thread: any; never blocks."""
        self._loop.post(lambda: self._control(self._stage.pace.resume))

    def step(self) -> None:
        """Let every robot that waits begin one step; a run that is not paused is paused. Thread: any; never blocks."""
        self._loop.post(lambda: self._control(self._stage.pace.step))

    @property
    def is_paused(self) -> bool:
        """Whether it is paused. Thread: any."""
        return self._stage.pace.is_paused

    def _control(self, action: Callable[[], None]) -> None:
        if self._phase is _Phase.STEPS and not self._stage.is_stopping:
            action()

    def _heed_aborts(self) -> None:
        needed = {_Phase.STEPS: 1, _Phase.FINALLY: 2}.get(self._phase)
        if needed is not None and len(self._abort_reasons) >= needed:
            self._stage.stop()

    # The run's own thread.

    def _run(self) -> None:
        span = self._new_span()
        try:
            with span.current() if span is not None else nullcontext():
                self._loop.run(self._conduct())
        except BaseException as error:  # noqa: BLE001  # whoever waits must get a report
            self._fail(error)
        if span is not None:
            span.end(self._outcome()[1])
        try:
            self._future.set(self._conclude())
        except BaseException as error:  # noqa: BLE001  # or at least an answer
            self._future.set_exception(error)

    def _new_span(self) -> spans.Span | None:
        if spans.tracer is None:
            return None
        scenario = self._plan.scenario.name
        about = {"eal.scenario": scenario, "eal.fleet": self._fleet.name}
        return spans.tracer.begin_trace(f"scenario {scenario}", about)

    def _conduct(self) -> Branch:
        yield from self._guarded(self._opening())
        self._heed_aborts()
        yield self._loop.breathe()  # a pause that was asked for before the start
        first = self._resumption.first_step if self._resumption is not None else 0
        yield from self._guarded(self._performer.steps(first, self._on_step))
        self._stage.pace.open_for_end()
        end_robots(self._stage, self._performer.unfinished_roles())
        if self._stage.is_stopping:
            yield from self._guarded(self._stage.halt(list(self._robots.values())))
        self._phase = _Phase.FINALLY
        if len(self._abort_reasons) < 2:
            yield from self._guarded(self._performer.finally_steps())
        self._is_aborted = bool(self._abort_reasons)
        self._phase = _Phase.HALTS
        yield from self._guarded(self._stage.halt(list(self._robots.values())))

    def _guarded(self, branch: Branch) -> Branch:
        """Go through a part of the run; an error in it must not keep the next part from running."""
        try:
            yield from branch
        except Exception as error:  # noqa: BLE001  # it goes into the report
            self._fail(error)

    def _opening(self) -> Branch:
        if self._resumption is not None:
            self._tell(partial(self._run_continued, self._resumption))
            seat_robots(self._stage)
            restore(self._stage, self._resumption)
        else:
            self._tell(self._run_started)
            seat_robots(self._stage)
            if keeps_checkpoints(self._plan.scenario.file):
                self._tell(lambda time_s: checkpoint(self._stage, 0, time_s))
        tell_lost(self._stage)
        yield from ()

    def _run_started(self, time_s: float) -> RunStarted:
        plan, config = self._plan, self._fleet.config
        return RunStarted(
            time_s,
            scenario=plan.scenario.name,
            scenario_file=str(plan.scenario.source),
            scenario_hash=scenario_hash(plan.scenario),
            fleet=config.name,
            fleet_file=str(config.source),
            seed=config.seed,
            rate=_rate(self._fleet),
            parameters={name: to_record(value) for name, value in plan.scenario.parameters.items()},
            roles=plan.roles,
            spares=plan.spares,
            robots=plan.robots,
            calls=plan.calls,
        )

    def _run_continued(self, resumption: Resumption, time_s: float) -> RunContinued:
        plan, started = self._plan, self._started.isoformat() if self._started is not None else ""
        name, fleet = plan.scenario.name, self._fleet.config.name
        return RunContinued(time_s, resumption.first_step, started, name, fleet, plan.robots, plan.calls)

    def _on_step(self, index: int) -> None:
        if keeps_checkpoints(self._plan.scenario.file):
            self._tell(lambda time_s: checkpoint(self._stage, index + 1, time_s))

    def _tell(self, make_event: Callable[[float], Event]) -> float:
        """Note an event; return the seconds since the run's start."""
        time_s = self._stage.now_s()
        self._journal.tell(make_event(time_s))
        return time_s

    def _fail(self, error: BaseException) -> None:
        """Note an error of the engine itself: the steps are stopped, but never what makes the robots safe."""
        logger = get_logger(scenario=self._plan.scenario.name)
        if isinstance(error, OSError):  # a full disk, say, which a traceback explains no better
            error = ScenarioError(f"its record in {self._directory} cannot be written: {error.strerror or error}")
            logger.error(str(error))
        else:
            logger.error("the run had an internal error", exc_info=error)
        self._error = self._error or error
        if self._phase is _Phase.STEPS:
            self._stage.stop()

    # The report.

    def _conclude(self) -> Report:
        """Return the report, after writing it down."""
        self._see_off_threads()
        duration_s = self._stage.now_s()
        try:
            self._tell(lambda time_s: RunEnded(time_s, self._report(duration_s)))
        except OSError as error:
            self._fail(error)
        report = self._report(duration_s)
        try:
            self._journal.write_summary(report)
        except OSError as error:
            self._fail(error)
            report = self._report(duration_s)
        self._journal.close()
        return report

    def _see_off_threads(self) -> None:
        """Name the functions of Python steps that do not heed that nobody waits for them."""
        alive = [thread for thread in self._stage.threads if thread.is_alive()]
        if not alive:
            return
        end_s = REAL_TIME.now() + _THREADS_END_S
        with self._fleet.clock.outside():
            for thread in alive:
                thread.join(max(0.0, end_s - REAL_TIME.now()))
        for thread in alive:
            if thread.is_alive():
                get_logger(thread=thread.name).error("does not end though nobody waits for it; it was left behind")

    def _report(self, duration_s: float) -> Report:
        scenario, config = self._plan.scenario, self._fleet.config
        outcome, error = self._outcome()
        return Report(
            scenario=scenario.name,
            scenario_file=str(scenario.source),
            fleet=config.name,
            fleet_file=str(config.source),
            seed=config.seed,
            rate=_rate(self._fleet),
            parameters={name: to_record(value) for name, value in scenario.parameters.items()},
            roles={role: list(names) for role, names in self._plan.roles.items()},
            wall_started=self._started.isoformat() if self._started is not None else "",
            duration_s=duration_s,
            paused_s=self._stage.pace.paused_s,
            continued_s=self._continued_s(),
            outcome=outcome,
            error=ErrorReport.of(error) if error is not None else None,
            robots={name: report_robot(self._stage, robot) for name, robot in self._robots.items()},
            variables=variables_of_run(self._stage),
            steps=tuple(self._stage.records),
            starts=tuple(self._stage.starts),
        )

    def _continued_s(self) -> tuple[float, ...]:
        before = self._resumption
        return (*before.continued_s, before.time_s) if before is not None else ()

    def _outcome(self) -> tuple[RunOutcome, BaseException | None]:
        culprits = [robot.error for robot in self._robots.values() if robot.outcome in ("failed", "dropped")]
        culprits += self._stage.failures
        if self._error is not None or culprits:
            return "failed", self._error or culprits[0]
        if self._is_aborted:
            return "aborted", ScenarioError(f"aborted: {self._abort_reasons[0]}")
        return "done", None


def _rate(fleet: Fleet) -> Rate:
    """Return how fast the fleet's clock runs; what the file says of a clock that stands still by itself."""
    return fleet.clock.rate if isinstance(fleet.clock, ScaledClock | LockStepClock) else fleet.config.rate
