"""The check of a scenario against a fleet: its roles, resources, commands and values, on simulated robots."""

from __future__ import annotations

from dataclasses import dataclass

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError, EALError, Problem
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.twins import SimulatedFleet, simulated
from eal_actors.scenario import Scenario, load_scenario, make_plan
from eal_actors.scenario.language.binding import find_candidates
from eal_actors.scenario.language.parameters import missing_parameters


@dataclass(frozen=True, slots=True)
class TogetherCheck:
    """The result of checking a scenario against a fleet.

    Attributes:
        problems: what the fleet cannot do, each with its position in the scenario.
        warnings: why something was not checked.
        summary: that all was checked and fits; empty otherwise.
    """

    problems: tuple[Problem, ...] = ()
    warnings: tuple[str, ...] = ()
    summary: str = ""


def check_together(scenario_file: str, fleet_file: str) -> TogetherCheck:
    """Bind a scenario to a fleet, and check every call on the simulated twins of its robots; no device is opened.

    Raises:
        ConfigError: one of the files has problems of its own.
    """
    scenario, config = load_scenario(scenario_file), EALConfigManager.load(fleet_file).fleet
    try:
        bound = {name for names in find_candidates(scenario, config).values() for name in names}
    except ConfigError as error:
        return TogetherCheck(error.problems)
    pair = f"{scenario_file} on {fleet_file}"
    if missing := missing_parameters(scenario.file, scenario.parameters, scenario.tree):
        names = ", ".join(problem.path for problem in missing)
        return TogetherCheck(warnings=(f"{pair}: the calls were not checked, because {names} has no default",))
    try:
        twins = simulated(config, bound)
    except ConfigError as error:
        reasons = "; ".join(problem.message for problem in error.problems)
        return TogetherCheck(warnings=(f"{pair}: the calls were not checked: {reasons}",))
    return _plan(scenario, twins, config, pair)


def _plan(scenario: Scenario, twins: SimulatedFleet, config: FleetConfig, pair: str) -> TogetherCheck:
    try:
        with Fleet(twins.config) as fleet:
            make_plan(scenario, fleet)
    except ConfigError as error:
        incomplete = {name: why for name, why in twins.left_out.items() if name in config.robots}
        if not incomplete:
            return TogetherCheck(error.problems)
        reasons = "; ".join(f"{name}: {why}" for name, why in incomplete.items())  # what is missing may be there
        return TogetherCheck(warnings=(*map(str, error.problems), f"{pair}: not all could be simulated: {reasons}"))
    except EALError as error:
        return TogetherCheck(warnings=(f"{pair}: the calls were not checked: {error.message}",))
    return TogetherCheck(summary=f"fits fleet '{config.name}'")
