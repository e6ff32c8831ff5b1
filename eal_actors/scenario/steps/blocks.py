"""The blocks `if`, `parallel` and `sequence`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, TypeAlias

from pydantic import BeforeValidator, Discriminator, Field, Tag
from typing_extensions import override

from eal_actors.kernel.errors import Problem
from eal_actors.kernel.strict_model import NAMES_ONLY, Name
from eal_actors.kernel.yaml_tree import YamlPath, format_path
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.executor import compute, perform_steps
from eal_actors.scenario.engine.frames import ExecutionContext, StepTask
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.engine.synchronization import StepGroup, find_meetings
from eal_actors.scenario.language.expressions import Namespace, evaluate, parse_bare, to_plain
from eal_actors.scenario.language.robot_check import RobotCheck, RobotScope
from eal_actors.scenario.language.scenario import Scenario
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.static_values import Guard
from eal_actors.scenario.language.values import MIN_ITEMS, NOT_EMPTY, ExpressionText, Text
from eal_actors.scenario.steps.base import BlockStep, Keys, Show, Step, Steps, roles_at_work
from eal_actors.scenario.steps.wording import until_words


class IfStep(BlockStep):
    """Perform steps if an expression is true, and others if it is not."""

    kind = "if"
    if_: ExpressionText = Field(alias="if")
    """An expression, without `${}`."""
    then: Steps
    else_: Steps | None = Field(default=None, alias="else")

    @override
    def children(self) -> Sequence[tuple[Keys, tuple[Step, ...]]]:
        return ((("then",), self.then), *(((("else",), self.else_),) if self.else_ is not None else ()))

    @override
    def conditions(self) -> Iterable[tuple[Keys, object]]:
        return ((("if",), self.if_),)

    @override
    def robots_inside(self, check: RobotCheck, path: YamlPath, here: RobotScope, keys: Keys) -> RobotScope:
        guard = Guard(parse_bare(self.if_)[0], keys == ("then",))
        return replace(here, values=here.values.under(guard))

    @override
    def block_words(self, show: Show) -> str:
        return f"if {self.if_}"

    @override
    def branch_words(self, keys: Keys) -> tuple[str, str]:
        return str(keys[-1]), str(keys[-1])

    @override
    def passes(self, scenario: Scenario) -> None:
        return None

    @override
    def perform_inside(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        condition, _ = parse_bare(self.if_)

        def work(names: Namespace) -> bool:
            return bool(to_plain(evaluate(condition, names), "the condition"))

        is_true = yield from compute(run, context, self, f"{path}.if", f"if {self.if_}", [condition], work)
        if is_true is None:
            return
        steps, key = (self.then, "then") if is_true else (self.else_ or (), "else")
        yield from perform_steps(run, steps, f"{path}.{key}", context.inside(self.on_failure))


def _branches_kind(value: object) -> str:
    return "named" if isinstance(value, Mapping) else "listed"


def _refuse_no_branch(value: object) -> object:
    if isinstance(value, Mapping) and not value:
        raise ValueError("is empty; it needs at least one branch")
    return value


Branches: TypeAlias = Annotated[
    Annotated[tuple[Steps, ...], Field(strict=False, json_schema_extra=MIN_ITEMS), NOT_EMPTY, Tag("listed")]
    | Annotated[
        dict[Name, Steps],
        BeforeValidator(_refuse_no_branch),
        Field(json_schema_extra={**NAMES_ONLY, "minProperties": 1}),
        Tag("named"),
    ],
    Discriminator(_branches_kind),
]


class ParallelStep(BlockStep):
    """Perform several branches at the same time."""

    kind = "parallel"
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
                message = f"role '{role}' is at work in branch '{taken[role]}' at the same time"
                check.report((*path, *keys), message)

    def _roles_by_branch(self, scenario: Scenario, path: YamlPath) -> Iterator[tuple[Keys, str]]:
        for keys, steps in self.children():
            for role in dict.fromkeys(roles_at_work(scenario, steps, (*path, *keys))):
                yield keys, role

    @override
    def scope_inside(self, check: ScopeCheck, scope: Scope) -> Scope:
        return replace(scope.inside(), is_beside=True)

    @override
    def shared_robots(
        self, scenario: Scenario, path: YamlPath, roles: Mapping[str, Sequence[str]]
    ) -> Iterator[Problem]:
        taken: dict[str, tuple[str, str]] = {}
        found: dict[tuple[YamlPath, str], None] = {}
        for keys, role in self._roles_by_branch(scenario, path):
            branch = str(keys[-1])
            for robot in roles[role]:
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
            branch = f"{path}.{format_path(keys)}"
            tasks.append((task, perform_steps(run, steps, branch, replace(inside, task=task))))
        yield from StepGroup(run, context, self.until).perform(tasks)


class SequenceStep(BlockStep):
    """Perform steps one after the other, with common settings such as a time limit."""

    kind = "sequence"
    sequence: Steps

    @override
    def children(self) -> Sequence[tuple[Keys, tuple[Step, ...]]]:
        return ((("sequence",), self.sequence),)

    @override
    def perform_inside(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        return perform_steps(run, self.sequence, f"{path}.sequence", context.inside(self.on_failure))
