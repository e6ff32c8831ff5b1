"""The run of a plan on a fleet: its thread, its control from outside, and its report."""

from __future__ import annotations

import enum
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Final

from typing_extensions import override

from eal_actors.actors.future import Future
from eal_actors.facade.fleet import Fleet
from eal_actors.facade.shutdown import ends_call
from eal_actors.kernel import spans
from eal_actors.kernel.clock import Clock, current_scope, in_scope, new_waiter, wait_in_scope, wall_time
from eal_actors.kernel.errors import CallCancelledError, ScenarioError
from eal_actors.kernel.log import get_logger
from eal_actors.scenario.engine import checkpoints
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.executor import perform_steps
from eal_actors.scenario.engine.frames import ExecutionContext, Participant, StepTask
from eal_actors.scenario.engine.loop import Coroutine, EventLoop
from eal_actors.scenario.engine.past_steps import PastSteps
from eal_actors.scenario.engine.plan import Plan, make_plan
from eal_actors.scenario.engine.python_functions import join_threads
from eal_actors.scenario.engine.synchronization import find_meetings
from eal_actors.scenario.language.binding import Wishes
from eal_actors.scenario.language.loading import load_scenario
from eal_actors.scenario.language.scenario import Scenario
from eal_actors.scenario.report.events import RunEnded, RunEvent
from eal_actors.scenario.report.files import image_writer
from eal_actors.scenario.report.journal import Journal, Listener
from eal_actors.scenario.report.resuming import Resumption
from eal_actors.scenario.report.summary import Report, RunOutcome

_INTERRUPTS: Final[dict[type[BaseException], str]] = {
    KeyboardInterrupt: "interrupted from the keyboard",
    SystemExit: "the program is to end",
    CallCancelledError: "its task was cancelled",
}


class _Phase(enum.Enum):
    STEPS = enum.auto()
    FINALLY = enum.auto()
    HALTS = enum.auto()


class _RunFuture(Future[Report]):
    """The future report; cancelling it aborts the run."""

    def __init__(self, run: Run, clock: Clock) -> None:
        super().__init__(clock)
        self._run_of = run

    @override
    def describe(self) -> str:
        return "a scenario's report"

    @override
    def _given_up(self) -> None:
        self._run_of.abort("its future was cancelled")


class Run:
    """One run of a scenario.

    The steps come first. Then, whatever happened, come the steps of `finally`, and after them every actuator of every
    robot is halted. A run that is stopped early halts them before `finally` as well.

    Args:
        plan: the plan, from `make_plan` for this fleet.
        directory: the run's folder: `summary.json`, `events.jsonl`, and a folder of saved answers for each robot.
            None keeps nothing.
        listeners: called with each event, in the run's own thread; they must not block.
        resumption: the state of an interrupted run to continue, from `read_run`; `directory` is its folder.
        keeps_files: whether the files outlive the run; if not, work whose only result is a file may be left out.

    Raises:
        ScenarioError: the scenario saves files, and there is no directory; or the run cannot be resumed.
    """

    def __init__(
        self,
        plan: Plan,
        fleet: Fleet,
        directory: Path | None = None,
        listeners: Sequence[Listener] = (),
        resumption: Resumption | None = None,
        *,
        keeps_files: bool = True,
    ) -> None:
        self._plan = plan
        self._file = plan.scenario.file
        self._fleet = fleet
        self._directory = directory
        self._listeners = listeners
        self._resumption = resumption
        self._saves = any(step.saves_files for *_, step in plan.scenario.walk())
        if self._saves and directory is None:
            raise ScenarioError(f"scenario {plan.scenario.name!r} saves files: give its run a `directory`")
        past = None
        if resumption is not None:
            resumption.require_safe(plan.scenario)
            if resumption.first_step < len(self._file.steps) and self._file.is_safe(resumption.first_step) is None:
                past = PastSteps.of(resumption, plan, fleet)
        self._loop = EventLoop(fleet.clock, self._fail)
        self._robots = {name: Participant(fleet[name]) for name in plan.robots}
        self._run = RunContext(plan, self._robots, self._loop, fleet, directory, self._emit, self._fail)
        self._run.past, self._run.keeps_files = past, keeps_files
        self._future = _RunFuture(self, fleet.clock)
        self._phase = _Phase.STEPS
        self._next_step = 0
        self._abort_reasons: list[str] = []
        self._error: BaseException | None = None
        self._is_aborted = self._is_started = False
        self._wall_started = ""

    def start(self) -> Future[Report]:
        """Start the run. The future is done when everything is over, with success whatever the run's outcome.

        Raises ScenarioError if it was started before, or the directory cannot be written or holds a run already.

        Thread: any, once; does not block.
        """
        if self._is_started:
            raise ScenarioError("this run was started already; make a new one")
        self._is_started = True
        self._journal = Journal(
            self._directory,
            self._listeners,
            is_resumed=self._resumption is not None,
            is_durable=self._run.losses is not None,
        )
        if self._saves:
            image_writer()  # its import takes long, and would delay the robots
        before_s = self._resumption.time_s if self._resumption is not None else 0.0
        self._wall_started, self._run.zero_s = wall_time().isoformat(), self._fleet.clock.now() - before_s
        name = f"scenario {self._plan.scenario.name}"
        self._fleet.clock.start(threading.Thread(target=self._main, name=name, daemon=True))
        return self._future

    @property
    def start_s(self) -> float:
        """Its start by the fleet's clock, in s: the zero of its events; raise ScenarioError if it was not started."""
        if not self._wall_started:
            raise ScenarioError("this run was not started")
        return self._run.zero_s

    # Control.

    def abort(self, reason: str) -> None:
        """Stop the robots and go to `finally`; a second call skips the rest of `finally`, but not the halts.

        Thread: any, signal handlers too; never blocks, takes no lock.
        """
        self._abort_reasons.append(reason)
        self._loop.post(self._apply_aborts)

    def pause(self) -> None:
        """Begin no more steps; those under way continue. Time-outs of meetings and waits do not advance.

        It has no effect on a run that is paused, or whose steps are over. Thread: any; never blocks.
        """
        self._loop.post(lambda: self._control(self._run.pauses.pause))

    def resume(self) -> None:
        """End a pause; it has no effect without one. Thread: any; never blocks."""
        self._loop.post(lambda: self._control(self._run.pauses.resume))

    def step(self) -> None:
        """Let every waiting robot begin one step; pause a run that is not paused. Thread: any; never blocks."""
        self._loop.post(lambda: self._control(self._run.pauses.step))

    def set_parameters(self, values: Mapping[str, object]) -> None:
        """Change parameters for the steps that begin later. Thread: any; never blocks."""
        self._loop.post(lambda: self._run.main.variables.update(values))

    def log(self, robot: str | None, text: str) -> None:
        """Add a line to the record, as the step `log` does. Thread: any; never blocks."""
        self._loop.post(lambda: self._run.log(robot, text))

    @property
    def is_paused(self) -> bool:
        """Whether it is paused. Thread: any."""
        return self._run.pauses.is_paused

    def _control(self, action: Callable[[], None]) -> None:
        if self._phase is _Phase.STEPS and not self._run.is_stopping:
            action()

    def _apply_aborts(self) -> None:
        needed = {_Phase.STEPS: 1, _Phase.FINALLY: 2}.get(self._phase)
        if needed is not None and len(self._abort_reasons) >= needed:
            self._run.stop()

    # The run's own thread.

    def _main(self) -> None:
        scenario = self._plan.scenario.name
        about = {"eal.scenario": scenario, "eal.fleet": self._fleet.name}
        span = spans.tracer.begin_trace(f"scenario {scenario}", about) if spans.tracer is not None else None
        try:
            with span.current() if span is not None else nullcontext(), self._run.budget.applied():
                self._loop.run(self._phases())
        except BaseException as error:  # noqa: BLE001  # the caller waits for a report
            self._fail(error)
        if span is not None:
            span.end(self._outcome()[1])
        try:
            self._future.set(self._conclude())
        except BaseException as error:  # noqa: BLE001  # the caller waits for an answer
            self._future.set_exception(error)

    def _phases(self) -> Coroutine:
        run, everyone, steps = self._run, list(self._robots.values()), self._perform_steps()
        yield from self._guarded(self._prepare())
        self._apply_aborts()
        yield self._loop.checkpoint()  # a pause may have been requested before the start
        yield from self._guarded(steps if run.losses is None else run.losses.watched(steps))
        run.pauses.end()
        checkpoints.end_robots(run, self._next_step)
        if run.is_stopping:
            yield from self._guarded(run.halt(everyone))
        self._phase = _Phase.FINALLY
        if len(self._abort_reasons) < 2:
            yield from self._guarded(self._perform_finally())
        self._is_aborted = bool(self._abort_reasons or run.emergency)
        self._phase = _Phase.HALTS
        yield from self._guarded(run.halt(everyone))
        if run.threads and join_threads(run.threads, self._fleet.clock):
            yield from self._guarded(run.halt(everyone))

    def _guarded(self, coroutine: Coroutine) -> Coroutine:
        """Perform a phase of the run; an error in it must not keep the next phase from running."""
        try:
            yield from coroutine
        except Exception as error:  # noqa: BLE001  # it goes into the report
            self._fail(error)

    def _prepare(self) -> Coroutine:
        run = self._run
        if self._resumption is not None:
            self._emit(partial(checkpoints.run_continued, run, self._resumption.first_step, self._wall_started))
            checkpoints.fill_slots(run)
            checkpoints.restore(run, self._resumption)
            if run.losses is not None:  # what the controller that died holds outlives it
                network = self._fleet.config.network
                yield run.loop.sleep(run.clock.of_real(max(network.lease_s, network.dead_man_s)))
        else:
            self._emit(partial(checkpoints.run_started, run))
            checkpoints.fill_slots(run)
            self._keep_checkpoint(0)
        checkpoints.report_lost(run)

    def _keep_checkpoint(self, next_step: int) -> None:
        if self._directory is not None and self._file.keeps_checkpoints:
            self._emit(partial(checkpoints.make_checkpoint, self._run, next_step))

    def _perform_steps(self) -> Coroutine:
        run, steps = self._run, self._file.steps
        task = StepTask(meets=find_meetings(run.main, steps))
        context = ExecutionContext(task, run.main)
        run.barriers.enter(task)
        first = self._next_step = self._resumption.first_step if self._resumption is not None else 0
        for index in range(first, len(steps)):
            if not run.may_begin(context):
                return
            self._next_step = index
            yield from steps[index].perform(run, context.of(steps[index]), f"steps[{index}]")
            if not run.is_stopping:
                self._next_step = index + 1
                self._keep_checkpoint(index + 1)

    def _perform_finally(self) -> Coroutine:
        """Perform `finally` with all robots that ever took part, innermost parts first; failures stop nothing."""
        run = self._run
        run.is_stopping = False
        for context in [*reversed(run.open_parts), ExecutionContext(StepTask(), run.main)]:
            frame = context.frame
            ending = ExecutionContext(StepTask(slot=frame.slot), frame, frame.slot, context.role, is_finally=True)
            yield from perform_steps(run, frame.scenario.file.finally_, f"{frame.prefix}finally", ending)

    # Events and errors.

    def _emit(self, make_event: Callable[[float], RunEvent]) -> float:
        """Record an event; return the seconds since the run's start."""
        time_s = self._run.now_s()
        self._journal.write(make_event(time_s))
        return time_s

    def _fail(self, error: BaseException) -> None:
        """Record an error of the engine itself: it stops the steps, but never what makes the robots safe."""
        logger = get_logger(scenario=self._plan.scenario.name)
        if isinstance(error, OSError):  # such as a full disk; a traceback would not help
            error = ScenarioError(f"its record in {self._directory} cannot be written: {error.strerror or error}")
            logger.error(str(error))
        else:
            logger.error("the run had an internal error", exc_info=error)
        self._error = self._error or error
        if self._phase is _Phase.STEPS:
            self._run.stop()

    # The report.

    def _conclude(self) -> Report:
        duration_s = self._run.now_s()
        try:
            self._emit(lambda time_s: RunEnded(time_s, self._report(duration_s)))
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
        return checkpoints.make_report(self._run, self._resumption, self._wall_started, duration_s, self._outcome())

    def _outcome(self) -> tuple[RunOutcome, BaseException | None]:
        errors = self._run.errors()
        if self._error is not None or errors:
            return "failed", self._error or errors[0]
        if self._is_aborted:
            return "aborted", ScenarioError(f"aborted: {[*self._abort_reasons, self._run.emergency][0]}")
        return "done", None


def run_scenario(
    scenario: Path | Scenario,
    fleet: Fleet,
    *,
    directory: Path | None = None,
    listeners: Sequence[Listener] = (),
    parameters: Mapping[str, object] | None = None,
    binding: Wishes | None = None,
) -> Report:
    """Run a scenario from beginning to end.

    Ctrl-C, SIGTERM, SIGHUP and the cancellation of the caller's task abort it, and are raised again after its end.

    Arguments as for `Run`; `parameters` and `binding` as for `make_plan`.

    Raises:
        ConfigError: the problems of the file, or what the fleet cannot do.
        RobotFailedError: as for `make_plan`.
        ScenarioError: as for `Run`.

    Thread: blocks the caller.
    """
    loaded = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    run = Run(make_plan(loaded, fleet, binding=binding, parameters=parameters), fleet, directory, listeners)
    interrupts: list[BaseException] = []

    def interrupt(error: BaseException) -> None:
        interrupts.append(error)
        run.abort(next(reason for kind, reason in _INTERRUPTS.items() if isinstance(error, kind)))

    with ends_call(interrupt):
        report = run.start()
        over = new_waiter()
        report.add_done_callback(lambda _: fleet.clock.wake(over))
        scope = current_scope()
        while not report.done():
            try:
                with in_scope(scope):
                    wait_in_scope(fleet.clock, over, None)
            except tuple(_INTERRUPTS) as error:  # also from a signal handler of the caller's own
                interrupt(error)
                scope = None if isinstance(error, CallCancelledError) else scope
    if interrupts:
        raise interrupts[0]
    return report.get()
