"""The check of a scenario against a fleet: its roles, resources, commands and values, on simulated robots."""

from __future__ import annotations

from dataclasses import dataclass, replace

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError, EALError, PluginError, Problem
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.twins import SimulatedFleet, simulated
from eal_actors.scenario import Scenario, make_plan
from eal_actors.scenario.language.binding import match_roles
from eal_actors.scenario.language.loading import examine_scenario
from eal_actors.scenario.language.parameters import missing_parameters


@dataclass(frozen=True, slots=True)
class TogetherCheck:
    """The result of checking a scenario against a fleet.

    `problems` are what the fleet cannot do, each with its position in the scenario; `summary` is empty unless all fits.
    """

    problems: tuple[Problem, ...] = ()
    warnings: tuple[str, ...] = ()
    summary: str = ""


def check_together(scenario_file: str, fleet_file: str) -> TogetherCheck:
    """Bind a scenario to a fleet, and check every call on the simulated twins of its robots; no device is opened.

    What is wrong in the scenario itself is left out, and not reported again. Raises ConfigError if the fleet file has
    problems of its own.
    """
    config = EALConfigManager.load(fleet_file).fleet
    scenario, is_new = examine_scenario(scenario_file)
    if scenario is None:
        return TogetherCheck()
    found = _check(scenario, config, f"{scenario_file} on {fleet_file}")
    return replace(found, problems=tuple(filter(is_new, found.problems)))


def _check(scenario: Scenario, config: FleetConfig, pair: str) -> TogetherCheck:
    candidates, unbound = match_roles(scenario, config)
    bound = {name for names in candidates.values() for name in names}
    if unbound and not bound:
        return TogetherCheck(tuple(unbound))
    if missing := missing_parameters(scenario, scenario.parameters):
        names = ", ".join(problem.path for problem in missing)
        warning = f"{pair}: the calls were not checked, because {names} has no default"
        return TogetherCheck(tuple(unbound), (warning,))
    try:
        twins = simulated(config, bound)
    except ConfigError as error:
        reasons = "; ".join(dict.fromkeys(problem.message for problem in error.problems))
        return TogetherCheck(tuple(unbound), (f"{pair}: the calls were not checked: {reasons}",))
    except PluginError as error:
        return TogetherCheck(tuple(unbound), (f"{pair}: the calls were not checked: {error.message}",))
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
