"""The runs of a sweep, as a worker process performs them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ScenarioError
from eal_actors.lab.sweeping.sweep import fleet_hash
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.twins import simulated
from eal_actors.scenario import Scenario, load_scenario, run_scenario
from eal_actors.scenario.language.binding import bound_robots
from eal_actors.scenario.language.parameters import with_parameters
from eal_actors.scenario.language.scenario import scenario_hash


@dataclass(frozen=True, slots=True)
class SweepTask:
    """A run for a worker: its folder, which does not exist yet, the values of all parameters, and the seed."""

    directory: Path
    parameters: Mapping[str, Any]
    seed: int


@dataclass
class SweepWorker:
    """Performs runs of a sweep, whose files it loads at the first; the hashes are those at the start of the sweep."""

    scenario: Path
    scenario_hash: str
    fleet: Path
    fleet_hash: str
    keep: Sequence[str]
    _loaded: tuple[Scenario, FleetConfig] | None = None

    def __call__(self, task: SweepTask) -> None:
        """Run the scenario once; raise EALError if the run could not start."""
        self._loaded = loaded, fleet_config = self._loaded or self._load()
        scenario = with_parameters(loaded, task.parameters)
        bound = bound_robots(scenario, fleet_config)
        config = replace(simulated(fleet_config, bound, self.keep).config, seed=task.seed)
        with Fleet(config).connect(bound) as fleet:
            for problem in fleet.problems:
                raise problem
            # With checkpoints, a run records its variables after each step of the top level.
            file = scenario.file.model_copy(update={"safe_to_repeat": True})
            run_scenario(replace(scenario, file=file), fleet, directory=task.directory)

    def _load(self) -> tuple[Scenario, FleetConfig]:
        scenario, config = load_scenario(self.scenario), EALConfigManager.load(self.fleet).fleet
        if scenario_hash(scenario) != self.scenario_hash:
            raise ScenarioError(f"{self.scenario} has changed since the sweep began")
        if fleet_hash(config, self.keep) != self.fleet_hash:
            raise ScenarioError(f"{self.fleet}, or its world, has changed since the sweep began")
        return scenario, config
