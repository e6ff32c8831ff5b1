"""Worker process of a sweep: performs runs one after the other."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import EALError, ScenarioError, error_text
from eal_actors.kernel.log import configure_logging
from eal_actors.lab.sweeping.sweep import fleet_hash
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.twins import simulated
from eal_actors.scenario import Scenario, load_scenario, run_scenario
from eal_actors.scenario.language.binding import find_candidates
from eal_actors.scenario.language.parameters import with_parameters
from eal_actors.scenario.language.scenario import scenario_hash


@dataclass(frozen=True, slots=True)
class SweepTask:
    """A run for a worker: its folder, which does not exist yet, the values of all parameters, and the seed."""

    directory: Path
    parameters: Mapping[str, Any]
    seed: int


@dataclass(frozen=True, slots=True)
class WorkerSettings:
    """Settings of all workers of a sweep.

    Attributes:
        scenario_hash: its hash at the start of the sweep.
        fleet_hash: its hash at the start of the sweep.
        keep: plugins that move nothing real and are not replaced by simulated ones.
    """

    scenario: Path
    scenario_hash: str
    fleet: Path
    fleet_hash: str
    keep: Sequence[str]
    log: Path


def serve(tasks: Connection, settings: WorkerSettings) -> None:
    """Perform runs until the connection closes; the answer to each is None, or the reason why it could not run.

    Thread: the main thread of a worker process, which ends with its parent.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent receives it too, and kills this process
    _die_with_parent()
    with settings.log.open("a", encoding="utf-8", buffering=1) as log:
        os.dup2(log.fileno(), 2)
        sys.stderr = log
        configure_logging("human", "warning")
        executor: _RunExecutor | None = None
        while True:
            try:
                task: SweepTask = tasks.recv()
            except EOFError:
                return
            try:
                executor = executor or _RunExecutor(settings)
                executor.run(task)
            except Exception as error:  # noqa: BLE001  # it becomes a row of the table
                tasks.send(str(error) if isinstance(error, EALError) else error_text(error))
            else:
                tasks.send(None)


class _RunExecutor:
    """The loaded scenario and fleet of a worker."""

    def __init__(self, settings: WorkerSettings) -> None:
        self._scenario = load_scenario(settings.scenario)
        self._config = EALConfigManager.load(settings.fleet).fleet
        if scenario_hash(self._scenario) != settings.scenario_hash:
            raise ScenarioError(f"{settings.scenario} has changed since the sweep began")
        if fleet_hash(self._config, settings.keep) != settings.fleet_hash:
            raise ScenarioError(f"{settings.fleet}, or its world, has changed since the sweep began")
        self._keep = settings.keep

    def run(self, task: SweepTask) -> None:
        """Run the scenario once."""
        scenario = with_parameters(self._scenario, task.parameters)
        bound = {name for names in find_candidates(scenario, self._config).values() for name in names}
        config = replace(simulated(self._config, bound, self._keep).config, seed=task.seed)
        with Fleet(config).connect(bound) as fleet:
            for problem in fleet.problems:
                raise problem
            run_scenario(_with_checkpoints(scenario), fleet, directory=task.directory)


def _with_checkpoints(scenario: Scenario) -> Scenario:
    """Return the scenario with checkpoints: its runs record their variables after each step of the top level."""
    return replace(scenario, file=scenario.file.model_copy(update={"safe_to_repeat": True}))


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, name="parent watch", daemon=True).start()
