"""A process that carries out runs, one after the other, as it is told."""

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
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.twins import simulated
from eal_actors.scenario import Scenario, load_scenario, run_scenario
from eal_actors.scenario.language.binding import find_candidates
from eal_actors.scenario.language.parameters import with_parameters
from eal_actors.scenario.language.scenario import scenario_hash


@dataclass(frozen=True, slots=True)
class Task:
    """One run, as it is told to a worker.

    Attributes:
        directory: the run's folder, which does not exist.
        parameters: the values of all parameters.
        seed: where all randomness starts from.
    """

    directory: Path
    parameters: Mapping[str, Any]
    seed: int


@dataclass(frozen=True, slots=True)
class Workplace:
    """What is the same for all runs of a sweep.

    Attributes:
        scenario: the scenario file.
        scenario_hash: what it said when the sweep began.
        fleet: the fleet file.
        fleet_hash: what it said then.
        keep: plugins that move nothing real, and run as they are.
        log: the file for log lines.
    """

    scenario: Path
    scenario_hash: str
    fleet: Path
    fleet_hash: str
    keep: Sequence[str]
    log: Path


def serve(tasks: Connection, workplace: Workplace) -> None:
    """Carry out runs until there are no more; the answer to each is None, or why it could not be carried out.

    Thread: the main thread of a process of its own, which ends when its parent does.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent has got it too, and ends this process
    _die_with_parent()
    with workplace.log.open("a", encoding="utf-8", buffering=1) as log:
        os.dup2(log.fileno(), 2)
        sys.stderr = log
        configure_logging("human", "warning")
        crew: _Crew | None = None
        while True:
            try:
                task: Task = tasks.recv()
            except EOFError:
                return
            try:
                crew = crew or _Crew(workplace)
                crew.carry_out(task)
            except Exception as error:  # noqa: BLE001  # it becomes a row of the table
                tasks.send(str(error) if isinstance(error, EALError) else error_text(error))
            else:
                tasks.send(None)


class _Crew:
    """Carries out runs on what the files say."""

    def __init__(self, workplace: Workplace) -> None:
        self._scenario = load_scenario(workplace.scenario)
        self._config = EALConfigManager.load(workplace.fleet).fleet
        if scenario_hash(self._scenario) != workplace.scenario_hash:
            raise ScenarioError(f"{workplace.scenario} has changed since the sweep began")
        if fleet_hash(self._config, workplace.keep) != workplace.fleet_hash:
            raise ScenarioError(f"{workplace.fleet}, or its world, has changed since the sweep began")
        self._keep = workplace.keep

    def carry_out(self, task: Task) -> None:
        """Run the scenario once."""
        scenario = with_parameters(self._scenario, task.parameters)
        bound = {name for names in find_candidates(scenario, self._config).values() for name in names}
        config = replace(simulated(self._config, bound, self._keep).config, seed=task.seed)
        _run(scenario, config, bound, task.directory)


def _run(scenario: Scenario, config: FleetConfig, robots: set[str], directory: Path) -> None:
    with Fleet(config).connect(robots) as fleet:
        for problem in fleet.problems:
            raise problem
        run_scenario(_with_checkpoints(scenario), fleet, directory=directory)


def _with_checkpoints(scenario: Scenario) -> Scenario:
    """Return a scenario whose runs write down their variables after each step of the top level."""
    return replace(scenario, file=scenario.file.model_copy(update={"safe_to_repeat": True}))


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, name="parent watch", daemon=True).start()
