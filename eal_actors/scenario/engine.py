"""Runs a plan on a fleet, in one thread however many robots there are."""

from __future__ import annotations

import enum
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Final

from eal_actors.actors.future import Future
from eal_actors.clock import ScaledClock, new_waiter, wall_time
from eal_actors.errors import ScenarioError
from eal_actors.facade.fleet import Fleet
from eal_actors.lock_step import LockStepClock, Rate
from eal_actors.log import get_logger
from eal_actors.scenario.calls import AnswerStep
from eal_actors.scenario.events import Event, RobotDropped, RunEnded, RunStarted
from eal_actors.scenario.files import image_writer
from eal_actors.scenario.journal import Journal, Listener
from eal_actors.scenario.loop import Branch, Loop
from eal_actors.scenario.model import ForStep, OnStep, RepeatStep, Step
from eal_actors.scenario.performer import HALT_TIMEOUT_S, Performer, RobotRun
from eal_actors.scenario.plan import Plan, make_plan
from eal_actors.scenario.report import ErrorReport, Report, RunOutcome
from eal_actors.scenario.scenario import Scenario, load_scenario

INTERRUPTED: Final = "interrupted from the keyboard"


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

    Raises:
        ScenarioError: the scenario saves files, and there is no directory.
    """

    def __init__(
        self, plan: Plan, fleet: Fleet, directory: Path | None = None, listeners: Sequence[Listener] = ()
    ) -> None:
        self._plan = plan
        self._fleet = fleet
        self._directory = directory
        self._listeners = listeners
        self._saves = _saves(plan.scenario.file.steps) or _saves(plan.scenario.file.finally_)
        if self._saves and directory is None:
            raise ScenarioError(f"scenario {plan.scenario.name!r} saves files, so its run needs a directory")
        self._loop = Loop(fleet.clock)
        self._robots = {name: RobotRun(fleet[name]) for name in plan.robots}
        self._performer = Performer(
            plan,
            self._robots,
            self._loop,
            max(HALT_TIMEOUT_S, fleet.clock.of_real(HALT_TIMEOUT_S)),
            directory,
            self._tell,
            self._fail,
        )
        self._future = _RunFuture(self, fleet)
        self._phase = _Phase.STEPS
        self._abort_reasons: list[str] = []
        self._error: BaseException | None = None
        self._is_aborted = False
        self._is_started = False
        self._start_s: float | None = None

    def start(self) -> Future[Report]:
        """Begin; the future is done when everything is over, with success whatever the run's outcome.

        Raises:
            ScenarioError: it was started before, or the directory cannot be written or holds a run already.

        Thread: any, once; does not block.
        """
        if self._is_started:
            raise ScenarioError("this run was started already; a run is for once")
        self._is_started = True
        self._journal = Journal(self._directory, self._listeners)
        if self._saves:
            image_writer()  # its import takes long, which would hold up the robots
        self._started, self._start_s = wall_time(), self._fleet.clock.now()
        name = f"scenario {self._plan.scenario.name}"
        self._fleet.clock.start(threading.Thread(target=self._run, name=name, daemon=True))
        return self._future

    @property
    def start_s(self) -> float:
        """When it began, in seconds of the fleet's clock: its events and records count from there.

        Raises:
            ScenarioError: it was not started.
        """
        if self._start_s is None:
            raise ScenarioError("this run was not started")
        return self._start_s

    def abort(self, reason: str) -> None:
        """Stop the robots and go to `finally`; called again, it skips the rest of `finally`, but not the halts.

        Thread: any, signal handlers too; never blocks, takes no lock.
        """
        self._abort_reasons.append(reason)
        self._loop.post(self._heed_aborts)

    def _heed_aborts(self) -> None:
        needed = {_Phase.STEPS: 1, _Phase.FINALLY: 2}.get(self._phase)
        if needed is not None and len(self._abort_reasons) >= needed:
            self._performer.stop()

    # The run's own thread.

    def _run(self) -> None:
        try:
            self._loop.run(self._conduct())
        except BaseException as error:  # noqa: BLE001  # whoever waits must get a report
            self._fail(error)
        try:
            self._future.set(self._conclude())
        except BaseException as error:  # noqa: BLE001  # or at least an answer
            self._future.set_exception(error)

    def _conduct(self) -> Branch:
        yield from self._guarded(self._opening())
        self._heed_aborts()
        yield from self._guarded(self._performer.steps())
        for robot in self._robots.values():
            if robot.outcome is None:
                robot.end("aborted" if self._performer.is_stopping else "done")
        if self._performer.is_stopping:
            yield from self._guarded(self._performer.halt(list(self._robots.values())))
        self._phase = _Phase.FINALLY
        if len(self._abort_reasons) < 2:
            yield from self._guarded(self._performer.finally_steps())
        self._is_aborted = bool(self._abort_reasons)
        self._phase = _Phase.HALTS
        yield from self._guarded(self._performer.halt(list(self._robots.values())))

    def _guarded(self, branch: Branch) -> Branch:
        """Go through a part of the run; an error in it must not keep the next part from running."""
        try:
            yield from branch
        except Exception as error:  # noqa: BLE001  # it goes into the report
            self._fail(error)

    def _opening(self) -> Branch:
        plan = self._plan
        self._tell(lambda time_s: RunStarted(time_s, plan.scenario.name, self._fleet.name, plan.robots, plan.calls))
        for name, error in plan.lost.items():
            self._robots[name].end("dropped", error)
            self._tell(partial(_dropped, name, ErrorReport.of(error)))
        yield from ()

    def _tell(self, make_event: Callable[[float], Event]) -> float:
        """Note an event; return the seconds since the run's start."""
        time_s = self._fleet.clock.now() - self.start_s
        self._journal.tell(make_event(time_s))
        return time_s

    def _fail(self, error: BaseException) -> None:
        """Note an error of the engine itself: the steps are stopped, but never what makes the robots safe."""
        get_logger(scenario=self._plan.scenario.name).error("the run had an internal error", exc_info=error)
        self._error = self._error or error
        if self._phase is _Phase.STEPS:
            self._performer.stop()

    # The report.

    def _conclude(self) -> Report:
        """Return the report, after writing it down."""
        duration_s = self._fleet.clock.now() - self.start_s
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
            started=self._started.isoformat(),
            duration_s=duration_s,
            outcome=outcome,
            error=ErrorReport.of(error) if error is not None else None,
            robots={name: robot.report() for name, robot in self._robots.items()},
            steps=tuple(self._performer.records),
        )

    def _outcome(self) -> tuple[RunOutcome, BaseException | None]:
        culprits = [robot.error for robot in self._robots.values() if robot.outcome in ("failed", "dropped")]
        if self._error is not None or culprits:
            return "failed", self._error or culprits[0]
        if self._is_aborted:
            return "aborted", ScenarioError(f"aborted: {self._abort_reasons[0]}")
        return "done", None


def run_scenario(
    scenario: Path | Scenario, fleet: Fleet, *, directory: Path | None = None, listeners: Sequence[Listener] = ()
) -> Report:
    """Run a scenario from beginning to end. Ctrl-C aborts it, and is raised again after its end.

    Args:
        scenario: a scenario, or its file.
        fleet: a connected fleet.
        directory: see Run.
        listeners: see Run.

    Raises:
        ConfigError: what is wrong with the file, or what the fleet cannot do.
        RobotFailedError: see make_plan.
        ScenarioError: see Run.

    Thread: blocks the caller.
    """
    loaded = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    run = Run(make_plan(loaded, fleet), fleet, directory, listeners)
    interrupts: list[None] = []

    def interrupt() -> None:
        interrupts.append(None)
        run.abort(INTERRUPTED)

    with _ctrl_c_calls(interrupt):
        report = run.start()
        over = new_waiter()
        report.add_done_callback(lambda _: fleet.clock.wake(over))
        while not report.done():
            try:
                fleet.clock.wait(over, None)
            except KeyboardInterrupt:  # from a handler of the caller's own
                interrupt()
    if interrupts:
        raise KeyboardInterrupt
    return report.get()


@contextmanager
def _ctrl_c_calls(action: Callable[[], None]) -> Iterator[None]:
    """Have Ctrl-C call an action in place of raising KeyboardInterrupt, which may strike anywhere, such as in `start`.

    Handlers that are not Python's own are left alone, and so are threads that never see Ctrl-C.
    """
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, lambda *_: action())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _rate(fleet: Fleet) -> Rate:
    """Return how fast the fleet's clock runs; what the file says of a clock that stands still by itself."""
    return fleet.clock.rate if isinstance(fleet.clock, ScaledClock | LockStepClock) else fleet.config.rate


def _dropped(robot: str, error: ErrorReport, time_s: float) -> RobotDropped:
    return RobotDropped(time_s, robot, error)


def _saves(steps: Sequence[Step]) -> bool:
    return any(
        (isinstance(step, AnswerStep) and step.save is not None)
        or (isinstance(step, OnStep | ForStep | RepeatStep) and _saves(step.do))
        for step in steps
    )
