"""Bind a scenario's roles to the robots of a fleet, and check all of it before anything moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from eal_actors.actors.handles import RobotHandle
from eal_actors.errors import ConfigError, EALError, Problem, RobotFailedError, RobotNotFoundError, UnavailableError
from eal_actors.facade.fleet import Fleet
from eal_actors.info import ResourceInfo
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.scenario.calls import CallStep, final_action
from eal_actors.scenario.model import ForStep, OnStep, RepeatStep, RoleSection, Step
from eal_actors.scenario.robot_check import RobotFacts, check_on_robots
from eal_actors.scenario.scenario import Scenario
from eal_actors.yaml_tree import YamlTree


@dataclass(frozen=True, slots=True)
class Plan:
    """A scenario that a fleet can carry out.

    Attributes:
        scenario: the scenario.
        roles: the robots of each role, in the order of the fleet.
        robots: the robots of all roles, in the order of the fleet.
        lost: why robots take no part from the start, by name; empty unless the scenario drops robots that fail.
        calls: how many calls the steps make when nothing fails, without those of `finally`.
    """

    scenario: Scenario
    roles: Mapping[str, tuple[str, ...]]
    robots: tuple[str, ...]
    lost: Mapping[str, EALError]
    calls: int


def make_plan(scenario: Scenario, fleet: Fleet) -> Plan:
    """Bind the roles, and check every call with every value of every loop on every robot.

    Args:
        scenario: the scenario.
        fleet: a connected fleet.

    Raises:
        ConfigError: with everything that the fleet cannot do, each with its place in the scenario file.
        RobotFailedError: a robot of the scenario did not start, and the scenario does not drop robots that fail, or
            would then have too few.
        RobotNotFoundError: the fleet is not connected.

    Thread: any; does not block.
    """
    roles = bind_roles(scenario, fleet.config)
    bound = {robot for robots in roles.values() for robot in robots}
    robots = tuple(robot for robot in fleet.config.robots if robot in bound)
    lost = {name: error for name in robots if (error := _not_started(fleet[name])) is not None}
    _check_lost(scenario, roles, lost)
    facts = {name: _facts(fleet[name]) for name in robots if name not in lost}
    if problems := check_on_robots(scenario, roles, facts):
        raise ConfigError(problems)
    live = {role: sum(robot not in lost for robot in names) for role, names in roles.items()}
    return Plan(scenario, roles, robots, lost, _count(scenario.file.steps, 1, live))


def bind_roles(scenario: Scenario, fleet: FleetConfig) -> dict[str, tuple[str, ...]]:
    """Return the robots of each role.

    Raises:
        ConfigError: a role asks for robots that the fleet does not know, or for more than it has.
    """
    problems: list[Problem] = []
    roles: dict[str, tuple[str, ...]] = {}
    manager = EALConfigManager(fleet)
    for role, section in scenario.file.roles.items():
        unknown = _unknown_words(role, section, manager, scenario.tree)
        problems += unknown
        if unknown:
            continue
        names = tuple(robot.name for robot in manager.select(section.robots, section.tags, section.types))
        roles[role] = names
        if len(names) < section.min:
            found = f"only {len(names)} ({', '.join(names)})" if names else "none"
            message = f"needs at least {section.min} of the robots of fleet '{fleet.name}', but {found} fit"
            problems.append(scenario.tree.problem(("roles", role), message, key=True))
    if problems:
        raise ConfigError(problems)
    return roles


def _unknown_words(role: str, section: RoleSection, manager: EALConfigManager, tree: YamlTree) -> list[Problem]:
    problems = []
    for key, words in (("robots", section.robots), ("tags", section.tags), ("types", section.types)):
        for index, word in enumerate(words or ()):
            try:
                manager.select(**{"names" if key == "robots" else key: [word]})
            except RobotNotFoundError as error:
                problems.append(tree.problem(("roles", role, key, index), error.message))
    return problems


def _not_started(robot: RobotHandle) -> EALError | None:
    try:
        robot.require_started()
    except (RobotFailedError, UnavailableError) as error:
        return RobotFailedError(error.message, robot=robot.name)
    return None


def _check_lost(scenario: Scenario, roles: Mapping[str, Sequence[str]], lost: Mapping[str, EALError]) -> None:
    """Raise RobotFailedError unless the scenario goes on without the robots that are lost."""
    drops = final_action(scenario.file.on_failure) == "drop"
    for role, names in roles.items():
        missing = [name for name in names if name in lost]
        needed = scenario.file.roles[role].min if drops else len(names)
        if missing and len(names) - len(missing) < needed:
            first = lost[missing[0]]
            others = f"; nor did {', '.join(missing[1:])} start" if missing[1:] else ""
            wanted = f"; role '{role}' needs at least {needed} robots" if drops else ""
            raise RobotFailedError(f"{first.message}{others}{wanted}", robot=first.robot)


def _facts(robot: RobotHandle) -> RobotFacts:
    resources: dict[str, ResourceInfo] = {}
    left_out = [problem.message for problem in robot.problems]
    for name, resource in robot.items():
        try:
            resources[name] = resource.info
        except UnavailableError as error:
            left_out.append(f"{name} {error.message}")
    return RobotFacts(resources, "".join(f"; left out: {reason}" for reason in left_out))


def _count(steps: Sequence[Step], robots: int, live: Mapping[str, int]) -> int:
    count = 0
    for step in steps:
        if isinstance(step, CallStep):
            count += robots
        elif isinstance(step, OnStep):
            count += _count(step.do, live[step.on], live)
        elif isinstance(step, ForStep | RepeatStep):
            count += len(step.loop[1]) * _count(step.do, robots, live)
    return count
