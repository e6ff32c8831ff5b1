"""Refuses branches that go on at once with the same robot: a robot goes through one `on` at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from eal_actors.kernel.errors import Problem
from eal_actors.kernel.yaml_tree import YamlPath, format_path
from eal_actors.scenario.checks.placing import roles_of
from eal_actors.scenario.model import AnyStep, OnStep, ParallelStep, ScenarioStep, inner_steps
from eal_actors.scenario.scenario import Scenario


def check_sharing(scenario: Scenario, roles: Mapping[str, Sequence[str]]) -> list[Problem]:
    """Return a problem for each robot that two branches of a `parallel` would use at once.

    Args:
        scenario: a scenario without problems of its own.
        roles: the robots of each role.
    """
    problems: list[Problem] = []
    _visit_all(scenario, scenario.file.steps, ("steps",), roles, problems)
    _visit_all(scenario, scenario.file.finally_, ("finally",), roles, problems)
    return problems


def _visit_all(
    scenario: Scenario,
    steps: Sequence[AnyStep],
    path: YamlPath,
    roles: Mapping[str, Sequence[str]],
    problems: list[Problem],
) -> None:
    for index, step in enumerate(steps):
        here = (*path, index)
        if isinstance(step, OnStep):
            continue
        if isinstance(step, ParallelStep):
            problems += _shared(scenario, step, here, roles)
        elif isinstance(step, ScenarioStep):
            part = scenario.parts[format_path(here)]
            theirs = {role: roles[step.roles.get(role, role)] for role in part.file.roles}
            problems += check_sharing(part, theirs)
        for keys, inner in inner_steps(step):
            _visit_all(scenario, inner, (*here, *keys), roles, problems)


def _shared(
    scenario: Scenario, step: ParallelStep, path: YamlPath, roles: Mapping[str, Sequence[str]]
) -> list[Problem]:
    taken: dict[str, tuple[str, str]] = {}
    found: dict[tuple[YamlPath, str], None] = {}
    for keys, inner in inner_steps(step):
        branch = str(keys[-1])
        for role in dict.fromkeys(roles_of(inner, (*path, *keys), scenario)):
            for robot in roles[role]:
                other, other_role = taken.setdefault(robot, (branch, role))
                if other != branch:
                    message = (
                        f"{robot} has role '{role}' here and role '{other_role}' in branch '{other}' at the same time"
                    )
                    found[(*path, *keys), message] = None
    return [scenario.problem(place, message) for place, message in found]
