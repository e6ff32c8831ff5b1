"""The binding of roles to robots of a fleet, spares included."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from eal_actors.device.info import ResourceInfo, unknown_name
from eal_actors.kernel.errors import ConfigError, Problem, RobotNotFoundError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.scenario.language.scenario import Scenario
from eal_actors.scenario.language.sections import RoleSection

Wishes = Mapping[str, Sequence[str]]
"""Robots by role, chosen when the scenario is run; they replace the criteria of the role."""


@dataclass(frozen=True, slots=True)
class RobotFacts:
    """The abilities of a robot.

    `left_out` is why resources may be missing; empty if none is. `denied` returns why the robot does not grant this
    program a method of a resource; None if it does.
    """

    resources: Mapping[str, ResourceInfo]
    left_out: str = ""
    denied: Callable[[str, str], str | None] = lambda *_: None


@dataclass(frozen=True, slots=True)
class Binding:
    """The robots that take part. Robots are in the order of the fleet; spares are kept in reserve."""

    roles: Mapping[str, tuple[str, ...]]
    spares: Mapping[str, tuple[str, ...]]

    @property
    def robots(self) -> frozenset[str]:
        """All robots, spares included."""
        return frozenset(name for names in (*self.roles.values(), *self.spares.values()) for name in names)


def find_candidates(scenario: Scenario, fleet: FleetConfig, wishes: Wishes | None = None) -> dict[str, tuple[str, ...]]:
    """Return the robots that fit each role by name, tag and type, from the fleet file alone.

    Raises ConfigError if a role names robots that the fleet does not have, or needs more than it has.
    """
    found, problems = match_roles(scenario, fleet, wishes)
    if problems:
        raise ConfigError(problems)
    return found


def bound_robots(scenario: Scenario, fleet: FleetConfig, wishes: Wishes | None = None) -> set[str]:
    """Return the robots that fit any role; raises as `find_candidates`."""
    return {name for names in find_candidates(scenario, fleet, wishes).values() for name in names}


def match_roles(
    scenario: Scenario, fleet: FleetConfig, wishes: Wishes | None = None
) -> tuple[dict[str, tuple[str, ...]], list[Problem]]:
    """Return the robots that fit each role by name, tag and type, as far as the fleet has them, and the problems."""
    wishes = wishes or {}
    problems = [
        scenario.problem(("roles",), unknown_name("role", role, scenario.file.roles), key=True)
        for role in wishes
        if role not in scenario.file.roles
    ]
    manager = EALConfigManager(fleet)
    found: dict[str, tuple[str, ...]] = {}
    for role, section in scenario.file.roles.items():
        unknown = _unknown_names(role, section, manager, scenario, wishes.get(role))
        problems += unknown
        if not unknown:
            found[role] = _matching(section, manager, wishes.get(role))
    return found, problems + _shortages(scenario, fleet, found)


def _matching(section: RoleSection, manager: EALConfigManager, wish: Sequence[str] | None) -> tuple[str, ...]:
    if wish is not None:
        return tuple(dict.fromkeys(wish))
    return tuple(robot.name for robot in manager.select(section.robots, section.tags, section.types))


def _unknown_names(
    role: str, section: RoleSection, manager: EALConfigManager, scenario: Scenario, wish: Sequence[str] | None
) -> list[Problem]:
    problems = []
    for name in wish or ():
        try:
            manager.select(names=[name])
        except RobotNotFoundError as error:
            problems.append(scenario.role_problem(role, (), f"as it was bound: {error.message}", key=True))
    for key, words in (("robots", section.robots), ("tags", section.tags), ("types", section.types)):
        for index, word in enumerate(() if wish is not None else words or ()):
            try:
                manager.select(**{"names" if key == "robots" else key: [word]})
            except RobotNotFoundError as error:
                problems.append(scenario.role_problem(role, (key, index), error.message))
    return problems


def _shortages(
    scenario: Scenario, fleet: FleetConfig, found: Mapping[str, Sequence[str]], why: Mapping[str, str] | None = None
) -> list[Problem]:
    problems = []
    for role, names in found.items():
        needed = scenario.file.roles[role].min
        if len(names) < needed:
            shown = f"only {len(names)} ({', '.join(names)})" if names else "none"
            reason = (why or {}).get(role, "")
            message = f"needs at least {needed} of the robots of fleet '{fleet.name}', but {shown} fit{reason}"
            problems.append(scenario.role_problem(role, (), message, key=True))
    return problems


def bind(
    scenario: Scenario,
    fleet: FleetConfig,
    candidates: Mapping[str, Sequence[str]],
    facts: Mapping[str, RobotFacts],
    wishes: Wishes | None = None,
) -> tuple[Binding, list[Problem]]:
    """Return the robots that take part among those that fit, and the problems.

    `candidates` are as `match_roles` returned them; a role without an entry gets no robots. A robot without `facts`
    is not up, and is assumed to fit. `wishes` are the robots of roles that were bound by the user.
    """
    problems: list[Problem] = []
    reasons: dict[str, str] = {}
    fitting: dict[str, tuple[str, ...]] = {}
    for role, section in scenario.file.roles.items():
        fits = candidates.get(role, ())
        lacking = {name: lack for name in fits if (lack := _lack(section, facts.get(name)))}
        named = section.robots is not None or role in (wishes or {})
        problems += [
            scenario.problem(("roles", role, "needs"), f"{name}: {lack}", key=True)
            for name, lack in lacking.items()
            if named
        ]
        fitting[role] = tuple(name for name in fits if name not in lacking)
        reasons[role] = "".join(f"; {name}: {lack}" for name, lack in list(lacking.items())[:3])
    roles = scenario.file.roles
    enough = {role: names for role, names in fitting.items() if len(candidates.get(role, ())) >= roles[role].min}
    return _with_spares(scenario, fleet, fitting), problems + _shortages(scenario, fleet, enough, reasons)


def _lack(section: RoleSection, facts: RobotFacts | None) -> str | None:
    """Return the ability that a robot lacks for a role, or None."""
    if facts is None:
        return None
    for resource, commands in section.needs.items():
        info = facts.resources.get(resource)
        if info is None:
            return unknown_name("resource", resource, facts.resources) + facts.left_out
        for command in commands:
            if not _has_command(info, command):
                return f"{resource} has no command {command!r}"
    return None


def _has_command(info: ResourceInfo, command: str) -> bool:
    if "send_cmd" not in info.methods:
        return False
    return not info.commands or any(known.name == command for known in info.commands)


def _with_spares(scenario: Scenario, fleet: FleetConfig, fitting: Mapping[str, tuple[str, ...]]) -> Binding:
    order = {name: index for index, name in enumerate(fleet.robots)}
    roles: dict[str, tuple[str, ...]] = {}
    for role, section in scenario.file.roles.items():
        names = sorted(fitting[role], key=order.__getitem__)
        most = max(section.min, len(names) - section.spares)
        roles[role] = tuple(names[: min(most, section.max or most)])
    at_work = {name for names in roles.values() for name in names}
    spares = {
        role: tuple(sorted(set(fitting[role]) - at_work, key=order.__getitem__))[: section.spares]
        for role, section in scenario.file.roles.items()
    }
    return Binding(roles, spares)
