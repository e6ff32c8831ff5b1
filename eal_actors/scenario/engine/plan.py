"""The plan of a run: a scenario bound to the robots of a fleet, and checked on them before anything moves."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field

from eal_actors.actors.handles import RobotHandle
from eal_actors.device.info import ResourceInfo
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError, EALError, Problem, RobotFailedError, UnavailableError
from eal_actors.scenario.engine.python_functions import StepFunction
from eal_actors.scenario.language.binding import Binding, RobotFacts, Wishes, bind, match_roles
from eal_actors.scenario.language.parameters import missing_parameters, with_parameters
from eal_actors.scenario.language.robot_check import RobotCheck
from eal_actors.scenario.language.scenario import Scenario
from eal_actors.scenario.language.values import final_action


@dataclass(frozen=True, slots=True)
class Plan:
    """A scenario that a fleet can run; robots are in the order of the fleet.

    Attributes:
        robots: those of all roles, spares included.
        lost: the errors of robots that did not start, by name; empty unless the scenario continues without them.
        calls: number of calls if nothing fails, as far as it is known, with those of `finally`.
    """

    scenario: Scenario
    roles: Mapping[str, tuple[str, ...]]
    robots: tuple[str, ...]
    lost: Mapping[str, EALError]
    calls: int
    spares: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    python: Mapping[str, StepFunction] = field(default_factory=dict)


def make_plan(
    scenario: Scenario, fleet: Fleet, *, binding: Wishes | None = None, parameters: Mapping[str, object] | None = None
) -> Plan:
    """Bind the roles, and check every call with every value of every loop on every robot.

    The fleet is connected. `binding` are robots by role in place of the role's criteria, `parameters` values in place
    of those of the scenario.

    Raises:
        ConfigError: with everything that the fleet cannot do, each with its position in the scenario file.
        RobotFailedError: a robot of the scenario did not start, and the scenario does not drop robots that fail, or
            would then have too few.
        RobotNotFoundError: the fleet is not connected.

    Thread: any; does not block.
    """
    scenario = with_parameters(scenario, parameters or {})
    missing = missing_parameters(scenario, scenario.parameters)
    candidates, unbound = match_roles(scenario, fleet.config, binding)
    if missing:
        raise ConfigError([*missing, *unbound])
    errors, facts = _inspect(fleet, {name for names in candidates.values() for name in names})
    bound, unfit = bind(scenario, fleet.config, candidates, facts, binding)
    robots = tuple(name for name in fleet.config.robots if name in bound.robots)
    lost = {name: errors[name] for name in robots if name in errors}
    if not unbound:
        _check_lost(scenario, bound, lost)
    python, unusable = _find_functions(scenario, fleet)
    check = RobotCheck(facts, bound, fleet.config.world, has_map=fleet.config.map_path is not None)
    if problems := [
        *unbound,
        *unfit,
        *unusable,
        *scenario.shared_robots(bound.roles),
        *check.problems_of(scenario, fleet.config.seed),
    ]:
        raise ConfigError(problems)
    live = {role: sum(robot not in lost for robot in names) for role, names in bound.roles.items()}
    parts = (("steps", scenario.file.steps), ("finally", scenario.file.finally_))
    calls = sum(scenario.count_calls(steps, (key,), None, live) for key, steps in parts)
    return Plan(scenario, bound.roles, robots, lost, calls, bound.spares, python)


def _find_functions(scenario: Scenario, fleet: Fleet) -> tuple[dict[str, StepFunction], list[Problem]]:
    """Return the functions of the Python steps by name, and the problems of their names and arguments."""
    functions: dict[str, StepFunction] = {}
    problems: dict[Problem, None] = {}  # several steps may run one part
    for owner, path, _, step in scenario.walk():
        if (problem := step.prepare(fleet.config, functions)) is not None:
            problems[owner.problem((*path, step.kind), problem)] = None
    return functions, list(problems)


def _inspect(fleet: Fleet, names: AbstractSet[str]) -> tuple[dict[str, EALError], dict[str, RobotFacts]]:
    """Return the errors of robots that did not start, and the abilities of all others, by name."""
    errors: dict[str, EALError] = {}
    facts: dict[str, RobotFacts] = {}
    for name in [name for name in fleet.config.robots if name in names]:
        try:
            fleet[name].require_started()
        except (RobotFailedError, UnavailableError) as error:
            errors[name] = RobotFailedError(error.message, robot=name)
        else:
            facts[name] = robot_facts(fleet[name])
    return errors, facts


def _check_lost(scenario: Scenario, bound: Binding, lost: Mapping[str, EALError]) -> None:
    """Raise RobotFailedError unless the scenario continues without the robots that are lost."""
    for role, names in bound.roles.items():
        section = scenario.file.roles[role]
        continues = final_action(section.on_failure or scenario.file.on_failure) in ("drop", "substitute")
        missing = [name for name in names if name in lost]
        ready = [name for name in bound.spares[role] if name not in lost]
        needed = section.min if continues else len(names)
        if missing and len(names) - len(missing) + (len(ready) if continues else 0) < needed:
            first = lost[missing[0]]
            others = f"; nor did {', '.join(missing[1:])} start" if missing[1:] else ""
            wanted = f"; role '{role}' needs at least {needed} robot{'s' * (needed != 1)}" if continues else ""
            raise RobotFailedError(f"{first.message}{others}{wanted}", robot=first.robot)


def robot_facts(robot: RobotHandle) -> RobotFacts:
    """Return the abilities of a started robot."""
    resources: dict[str, ResourceInfo] = {}
    left_out = list(robot.left_out)
    for name, resource in robot.items():
        try:
            resources[name] = resource.info
        except UnavailableError as error:
            left_out.append(f"{name} {error.message}")
    reasons = "".join(f"; left out: {reason}" for reason in left_out)
    return RobotFacts(resources, reasons, lambda resource, method: robot[resource].denied(method))
