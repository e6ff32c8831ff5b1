"""The step `while`: perform steps as long as a condition holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import ClassVar, Literal

from pydantic import Field
from typing_extensions import override

from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.computing import compute, compute_count
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.executor import perform_steps
from eal_actors.scenario.engine.frames import ExecutionContext
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions.evaluation import Namespace, evaluate, parse_bare, to_plain
from eal_actors.scenario.language.expressions.grammar import Expression
from eal_actors.scenario.language.robot_check import RobotCheck, RobotScope
from eal_actors.scenario.language.scenario import Keys, Show, Steps
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.static_values import Guard, StaticLoop
from eal_actors.scenario.language.values import INDEX, Count, ExpressionText, Held
from eal_actors.scenario.steps.loop import LoopStep


class WhileStep(LoopStep, kind="while"):
    """Perform steps as long as an expression is true; `${i}` is the number of the round, from 0."""

    holds: ClassVar[Mapping[str, Held]] = {"while_": "condition", "limit": "count"}
    while_: ExpressionText = Field(alias="while")
    """An expression, without `${}`."""
    limit: Count
    """Maximum number of rounds."""
    at_limit: Literal["fail", "go_on"] = "fail"
    """The outcome if the expression is still true after them."""
    do: Steps

    @override
    def check_values(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        check.unit(self.timeout_s, (*path, "timeout_s"), "s", "this")
        for keys, value in self.templates():
            check.template(value, (*path, *keys), scope)
        check.expression(self.while_, (*path, "while"), self.scope_inside(check, scope))  # it may use the index

    @override
    def loop(self) -> tuple[str, object]:
        return INDEX, None

    @override
    def robots_inside(self, check: RobotCheck, path: YamlPath, here: RobotScope, keys: Keys) -> RobotScope:
        guard = Guard(parse_bare(self.while_)[0], wanted=True)
        return replace(here, values=here.values.within(StaticLoop(INDEX, None)).within(guard))

    @override
    def block_words(self, show: Show) -> str:
        return f"while {self.while_}, at most {show(self.limit)} times"

    @override
    def perform_inside(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        limit = yield from compute_count(run, context, self, path, self.limit, "limit")
        condition, _ = parse_bare(self.while_)
        inside = context.inside(self.on_failure)
        for number in range(limit + 1 if limit is not None else 0):
            here = inside.in_loop(INDEX, number)
            if not run.may_begin(here):
                return
            yield from run.next_pass()
            is_last = number == limit and self.at_limit == "fail"
            work = partial(_is_true, condition, limit if is_last else None)
            goes_on = yield from compute(run, here, self, f"{path}.while", f"while {self.while_}", [condition], work)
            if not goes_on or number == limit:
                return
            yield from perform_steps(run, self.do, f"{path}.do", here)


def _is_true(condition: Expression, limit: int | None, names: Namespace) -> bool:
    """Return whether a condition is true; raise ScenarioError if it is true at the limit."""
    is_true = bool(to_plain(evaluate(condition, names), "the condition"))
    if is_true and limit is not None:
        raise ScenarioError(f"{condition.text.strip()} is still true after {limit} rounds, the limit")
    return is_true
