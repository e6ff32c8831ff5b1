"""The step `if`: perform one of two lists of steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

from pydantic import Field
from typing_extensions import override

from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.computing import compute
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.executor import perform_steps
from eal_actors.scenario.engine.frames import ExecutionContext
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions.evaluation import Namespace, evaluate, parse_bare, to_plain
from eal_actors.scenario.language.robot_check import RobotCheck, RobotScope
from eal_actors.scenario.language.scenario import Keys, Scenario, Show, Step, Steps
from eal_actors.scenario.language.static_values import Guard
from eal_actors.scenario.language.values import ExpressionText, Held
from eal_actors.scenario.steps.base import BlockStep


class IfStep(BlockStep, kind="if"):
    """Perform steps if an expression is true, and others if it is not."""

    holds: ClassVar[Mapping[str, Held]] = {"if_": "condition"}
    if_: ExpressionText = Field(alias="if")
    """An expression, without `${}`."""
    then: Steps
    else_: Steps | None = Field(default=None, alias="else")

    @override
    def children(self) -> Sequence[tuple[Keys, tuple[Step, ...]]]:
        return ((("then",), self.then), *(((("else",), self.else_),) if self.else_ is not None else ()))

    @override
    def robots_inside(self, check: RobotCheck, path: YamlPath, here: RobotScope, keys: Keys) -> RobotScope:
        return replace(here, values=here.values.within(Guard(parse_bare(self.if_)[0], keys == ("then",))))

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
