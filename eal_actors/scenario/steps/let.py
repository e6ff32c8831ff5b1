"""The step `let`: assign variables."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Final

from pydantic import Field
from typing_extensions import override

from eal_actors.kernel.strict_model import NAMES_ONLY
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions.evaluation import evaluate_bare, expressions_in
from eal_actors.scenario.language.scenario import Keys, Show
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.values import Value, VariableName, not_empty
from eal_actors.scenario.steps.base import FallibleStep

_NAMED: Final[dict[str, Any]] = {**NAMES_ONLY, "minProperties": 1}
Named = Annotated[dict[VariableName, Value], not_empty(dict, "name"), Field(json_schema_extra=_NAMED)]


class LetStep(FallibleStep, kind="let"):
    """Assign variables: the robot's own inside an `on`, those of the run outside."""

    is_instant = True
    let: Named
    """Name to an expression, without `${}`; a list holds expressions. A text needs quotes of its own."""

    @override
    def conditions(self) -> Iterable[tuple[Keys, object]]:
        return [(("let", name), value) for name, value in self.let.items()]

    @override
    def check_values(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        for name, value in self.let.items():  # each may use those before it
            check.expression(value, (*path, "let", name), scope)
            check.assign(name, (*path, "let", name), scope, key=True)

    @override
    def words(self, show: Show) -> str:
        return "let " + ", ".join(f"{name} = {show(value)}" for name, value in self.let.items())

    @property
    @override
    def label(self) -> str:
        return f"let {', '.join(self.let)}"

    @override
    def attempt(self, action: StepAction) -> Coroutine:
        for name, value in self.let.items():
            names = yield from action.evaluate(expressions_in(value, is_bare=True))
            action.run.assign(action.context, name, evaluate_bare(value, names))
