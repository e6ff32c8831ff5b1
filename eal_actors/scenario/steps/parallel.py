"""The step `parallel`: perform several branches at the same time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, TypeAlias

from pydantic import Discriminator, Field, Tag
from typing_extensions import override

from eal_actors.kernel.errors import Problem
from eal_actors.kernel.strict_model import NAMES_ONLY, Name
from eal_actors.kernel.yaml_tree import YamlPath, format_path
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.executor import StepGroup, perform_steps
from eal_actors.scenario.engine.frames import ExecutionContext, StepTask
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.engine.synchronization import find_meetings
from eal_actors.scenario.language.scenario import Keys, RobotsByRole, Scenario, Show, Step, Steps
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.values import MIN_ITEMS, NOT_EMPTY, Text, not_empty
from eal_actors.scenario.language.wording import until_words
from eal_actors.scenario.steps.base import BlockStep

Branches: TypeAlias = Annotated[
    Annotated[tuple[Steps, ...], Field(strict=False, json_schema_extra=MIN_ITEMS), NOT_EMPTY, Tag("listed")]
    | Annotated[
        dict[Name, Steps],
        not_empty(dict, "branch"),
        Field(json_schema_extra={**NAMES_ONLY, "minProperties": 1}),
        Tag("named"),
    ],
    Discriminator(lambda value: "named" if isinstance(value, Mapping) else "listed"),
]


class ParallelStep(BlockStep, kind="parallel"):
    """Perform several branches at the same time."""

    parallel: Branches
    """Lists of steps, or names to lists of steps."""
    until: Text = "all"
    """As with `on`."""

    @override
    def children(self) -> Sequence[tuple[Keys, tuple[Step, ...]]]:
        branches = self.parallel
        items = branches.items() if isinstance(branches, dict) else enumerate(branches)
        return tuple((("parallel", name), steps) for name, steps in items)

    @override
    def check_placement(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        super().check_placement(check, path, scope)
        check.until(self.until, path)
        if scope.role is not None:
            return
        taken: dict[str, str] = {}
        for keys, role in self._roles_by_branch(check.scenario, path):
            branch = str(keys[-1])
            if taken.setdefault(role, branch) != branch:
                check.report((*path, *keys), f"role '{role}' is at work in branch '{taken[role]}' at the same time")

    def _roles_by_branch(self, scenario: Scenario, path: YamlPath) -> Iterator[tuple[Keys, str]]:
        for keys, steps in self.children():
            for role in dict.fromkeys(scenario.roles_at_work(steps, (*path, *keys))):
                yield keys, role

    @override
    def scope_inside(self, check: ScopeCheck, scope: Scope) -> Scope:
        return replace(scope.inside(), is_beside=True)

    @override
    def shared_robots(self, scenario: Scenario, path: YamlPath, roles: RobotsByRole) -> Iterator[Problem]:
        taken: dict[str, tuple[str, str]] = {}
        found: dict[tuple[YamlPath, str], None] = {}
        for keys, role in self._roles_by_branch(scenario, path):
            branch = str(keys[-1])
            for robot in roles.get(role, ()):
                other, other_role = taken.setdefault(robot, (branch, role))
                if other != branch:
                    message = (
                        f"{robot} has role '{role}' here and role '{other_role}' in branch '{other}' at the same time"
                    )
                    found[(*path, *keys), message] = None
        yield from (scenario.problem(place, message) for place, message in found)
        yield from super().shared_robots(scenario, path, roles)

    @override
    def block_words(self, show: Show) -> str:
        return "parallel" + until_words(self.until)

    @override
    def branch_words(self, keys: Keys) -> tuple[str, str]:
        return "branch", f"branch {keys[-1]}"

    @override
    def perform_inside(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        inside = context.inside(self.on_failure)
        tasks = []
        for keys, steps in self.children():
            task = StepTask(context.task, context.slot, str(keys[-1]), find_meetings(context.frame, steps))
            tasks.append((task, perform_steps(run, steps, f"{path}.{format_path(keys)}", replace(inside, task=task))))
        yield from StepGroup(run, context, self.until).perform(tasks)
