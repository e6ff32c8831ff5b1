"""Runs a scenario from beginning to end, for those who wait for it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import Clock, new_waiter
from eal_actors.scenario.binding import Wishes
from eal_actors.scenario.engine.run import Run
from eal_actors.scenario.journal import Listener
from eal_actors.scenario.loading import load_scenario
from eal_actors.scenario.plan import make_plan
from eal_actors.scenario.report import Report
from eal_actors.scenario.scenario import Scenario

INTERRUPTED: Final = "interrupted from the keyboard"


def run_scenario(
    scenario: Path | Scenario,
    fleet: Fleet,
    *,
    directory: Path | None = None,
    listeners: Sequence[Listener] = (),
    parameters: Mapping[str, object] | None = None,
    binding: Wishes | None = None,
) -> Report:
    """Run a scenario from beginning to end. Ctrl-C aborts it, and is raised again after its end.

    Args:
        scenario: a scenario, or its file.
        fleet: a connected fleet.
        directory: see Run.
        listeners: see Run.
        parameters: values of its parameters, in place of their defaults.
        binding: robots by role, in place of what the role asks for.

    Raises:
        ConfigError: what is wrong with the file, or what the fleet cannot do.
        RobotFailedError: see make_plan.
        ScenarioError: see Run.

    Thread: blocks the caller.
    """
    loaded = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    run = Run(make_plan(loaded, fleet, binding=binding, parameters=parameters), fleet, directory, listeners)
    return _wait_for(run, fleet.clock)


def _wait_for(run: Run, clock: Clock) -> Report:
    """Start a run, and return what came of it; Ctrl-C aborts it, and is raised again after its end."""
    interrupts: list[None] = []

    def interrupt() -> None:
        interrupts.append(None)
        run.abort(INTERRUPTED)

    with _ctrl_c_calls(interrupt):
        report = run.start()
        over = new_waiter()
        report.add_done_callback(lambda _: clock.wake(over))
        while not report.done():
            try:
                clock.wait(over, None)
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
