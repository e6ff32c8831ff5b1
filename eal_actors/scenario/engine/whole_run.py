"""A scenario from beginning to end in the caller's thread, with Ctrl-C."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import new_waiter
from eal_actors.scenario.engine.plan import make_plan
from eal_actors.scenario.engine.run import Run
from eal_actors.scenario.language.binding import Wishes
from eal_actors.scenario.language.loading import load_scenario
from eal_actors.scenario.language.scenario import Scenario
from eal_actors.scenario.report.journal import Listener
from eal_actors.scenario.report.summary import Report

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
        directory: as for `Run`.
        listeners: as for `Run`.
        parameters: values of its parameters, in place of their defaults.
        binding: robots by role, in place of the criteria of the role.

    Raises:
        ConfigError: the problems of the file, or what the fleet cannot do.
        RobotFailedError: as for `make_plan`.
        ScenarioError: as for `Run`.

    Thread: blocks the caller.
    """
    loaded = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    run = Run(make_plan(loaded, fleet, binding=binding, parameters=parameters), fleet, directory, listeners)
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
    """Let Ctrl-C call an action instead of raising KeyboardInterrupt, which may strike anywhere, such as in `start`.

    A handler other than Python's own stays. Other threads never see Ctrl-C.
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
