"""The step `for`: perform steps once for each value of a list."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any

from pydantic import BeforeValidator, Discriminator, Field, Tag
from typing_extensions import override

from eal_actors.kernel.errors import EALError, ScenarioError
from eal_actors.kernel.strict_model import NAMES_ONLY
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.computing import compute
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.frames import ExecutionContext
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions.evaluation import Namespace, evaluate, expressions_in, render, to_plain
from eal_actors.scenario.language.expressions.grammar import Expression
from eal_actors.scenario.language.robot_check import RobotCheck, RobotScope
from eal_actors.scenario.language.scenario import Keys, Show, Steps
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.static_values import StaticLoop
from eal_actors.scenario.language.values import MIN_ITEMS, NOT_EMPTY, Value, VariableName, WholeExpression
from eal_actors.scenario.language.wording import short_value
from eal_actors.scenario.steps.loop import LoopStep


def _refuse_other_than_one(value: object) -> object:
    if isinstance(value, Mapping) and len(value) != 1:
        raise ValueError(f"must name one variable, not {len(value)}; write a loop inside a loop for more")
    return value


LoopList = Annotated[tuple[Value, ...], Field(strict=False, json_schema_extra=MIN_ITEMS), NOT_EMPTY]
LoopValues = Annotated[
    Annotated[LoopList, Tag("list")] | Annotated[WholeExpression, Tag("expression")],
    Discriminator(lambda value: "expression" if isinstance(value, str) and "${" in value else "list"),
]


class ForStep(LoopStep, kind="for"):
    """Perform steps once for each value of a list."""

    for_: Annotated[dict[VariableName, LoopValues], BeforeValidator(_refuse_other_than_one)] = Field(
        alias="for", json_schema_extra={**NAMES_ONLY, "minProperties": 1, "maxProperties": 1}
    )
    """Name of the variable, and its values: a list, or `${...}` that evaluates to one."""
    do: Steps

    @property
    def variable(self) -> str:
        """The variable."""
        return next(iter(self.for_))

    @property
    def values(self) -> tuple[object, ...] | str:
        """The values of the variable."""
        return next(iter(self.for_.values()))

    @override
    def templates(self) -> Iterable[tuple[Keys, object]]:
        return (*super().templates(), (("for", self.variable), self.values))

    @override
    def check_placement(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        super().check_placement(check, path, scope)
        name, here = self.variable, (*path, "for", self.variable)
        if name in scope.loops:
            check.report(here, f"'{name}' is the variable of a loop around this one already", key=True)
        check.variable_name(name, here, key=True)

    @override
    def loop(self) -> tuple[str, object]:
        return self.variable, self.values

    @override
    def robots_inside(self, check: RobotCheck, path: YamlPath, here: RobotScope, keys: Keys) -> RobotScope:
        values = self._static_values(check, (*path, "for", self.variable), here)
        return replace(here, values=here.values.within(StaticLoop(self.variable, values)))

    def _static_values(
        self, check: RobotCheck, path: YamlPath, here: RobotScope
    ) -> Sequence[object] | Expression | None:
        values = self.values
        expressions = expressions_in(values)
        if isinstance(values, tuple) and not expressions:
            return values
        if not here.are_known(expressions):
            return None
        if isinstance(values, tuple):
            if here.values.is_in_loop or here.values.needs_facts(expressions):
                return None
            try:
                return render(values, Namespace(here.values.constants))  # type: ignore[return-value]  # a tuple
            except EALError as error:
                check.report(here, path, error.message)
                return None
        for _, names in check.combinations(expressions, path, here):
            try:
                found = to_plain(evaluate(expressions[0], names), "the list")
            except EALError as error:
                check.report(here, path, error.message)
                return None
            if not isinstance(found, list):
                check.report(here, path, f"${{{expressions[0].text}}} is no list, but {found!r}")
                return None
        return expressions[0]

    @override
    def block_words(self, show: Show) -> str:
        return f"for {self.variable} in {show(self.values)}"

    @override
    def perform_inside(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        name, values = self.variable, self.values
        expressions = expressions_in(values)
        found: Any = values
        if expressions:
            found = yield from compute(run, context, self, f"{path}.for.{name}", f"for {name}", expressions, self._list)
        yield from self.perform_passes(run, context, path, name, found or ())

    def _list(self, names: Namespace) -> list[Any]:
        found = to_plain(render(self.values, names), "the list")
        if not isinstance(found, list):
            raise ScenarioError(f"a loop needs a list, not {short_value(found)}")
        return found
