"""The loops: `for`, `repeat` and `while`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag
from typing_extensions import override

from eal_actors.kernel.errors import EALError, ScenarioError
from eal_actors.kernel.strict_model import NAMES_ONLY
from eal_actors.kernel.yaml_tree import YamlPath, format_path
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.executor import compute, compute_count, perform_steps
from eal_actors.scenario.engine.frames import ExecutionContext
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions import (
    Expression,
    Namespace,
    evaluate,
    expressions_in,
    parse_bare,
    parse_template,
    render,
    to_plain,
)
from eal_actors.scenario.language.robot_check import RobotCheck, RobotScope
from eal_actors.scenario.language.scenario import Scenario
from eal_actors.scenario.language.scope import LoopVariable, Scope, ScopeCheck
from eal_actors.scenario.language.static_values import Guard, StaticLoop, value_of_parameters
from eal_actors.scenario.language.values import (
    INDEX,
    MIN_ITEMS,
    NOT_EMPTY,
    ExpressionText,
    Repeats,
    Value,
    VariableName,
    Wanted,
    WholeExpression,
)
from eal_actors.scenario.steps.base import BlockStep, Keys, Show, Steps
from eal_actors.scenario.steps.wording import short_value


class LoopStep(BlockStep):
    """A step that performs steps several times."""

    def loop_variable(self, check: ScopeCheck, scope: Scope) -> LoopVariable:
        """Return the variable of the loop, for the checks of its steps."""
        raise NotImplementedError

    @override
    def scope_inside(self, check: ScopeCheck, scope: Scope) -> Scope:
        return scope.within(self.loop_variable(check, scope))

    def perform_passes(
        self, run: RunContext, context: ExecutionContext, path: str, name: str, values: Iterable[object]
    ) -> Coroutine:
        """Perform the steps inside once for each value of the variable."""
        inside = context.inside(self.on_failure)
        for value in values:
            if not run.may_begin(context):
                return
            yield from run.next_pass()
            for keys, steps in self.children():
                yield from perform_steps(run, steps, f"{path}.{format_path(keys)}", inside.in_loop(name, value))


def _refuse_other_than_one(value: object) -> object:
    if isinstance(value, Mapping) and len(value) != 1:
        raise ValueError(f"must name one variable, not {len(value)}; write a loop inside a loop for more")
    return value


def _values_kind(value: object) -> str:
    return "expression" if isinstance(value, str) else "list"


LoopList = Annotated[tuple[Value, ...], Field(strict=False, json_schema_extra=MIN_ITEMS), NOT_EMPTY]
LoopValues = Annotated[
    Annotated[LoopList, Tag("list")] | Annotated[WholeExpression, Tag("expression")], Discriminator(_values_kind)
]


class ForStep(LoopStep):
    """Perform steps once for each value of a list."""

    kind = "for"
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
    def loop_variable(self, check: ScopeCheck, scope: Scope) -> LoopVariable:
        passes = len(self.values) if isinstance(self.values, tuple) else None
        return LoopVariable(self.variable, passes, check.is_static(self.values, scope))

    @override
    def robots_inside(self, check: RobotCheck, path: YamlPath, here: RobotScope, keys: Keys) -> RobotScope:
        values = self._static_values(check, (*path, "for", self.variable), here)
        return replace(here, values=here.values.within(StaticLoop(self.variable, values)))

    def _static_values(
        self, check: RobotCheck, path: YamlPath, here: RobotScope
    ) -> Sequence[object] | Expression | None:
        values = self.values
        expressions = list(expressions_in(values))
        if isinstance(values, tuple) and not expressions:
            return values
        if not here.are_known(expressions):
            return None
        if isinstance(values, tuple):
            if here.values.loops or here.values.needs_facts(expressions):
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
    def passes(self, scenario: Scenario) -> int | None:
        values = self.values if isinstance(self.values, tuple) else value_of_parameters(scenario, self.values)
        return len(values) if isinstance(values, list | tuple) else None

    @override
    def perform_inside(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        name, values = self.variable, self.values
        expressions = list(expressions_in(values))
        found: Any = values
        if expressions:
            here = f"{path}.for.{name}"
            found = yield from compute(run, context, self, here, f"for {name}", expressions, self._list)
        yield from self.perform_passes(run, context, path, name, found or ())

    def _list(self, names: Namespace) -> list[Any]:
        found = to_plain(render(self.values, names), "the list")
        if not isinstance(found, list):
            raise ScenarioError(f"a loop needs a list, not {short_value(found)}")
        return found


class RepeatStep(LoopStep):
    """Perform steps several times; `${i}` is the number of the round, from 0."""

    kind = "repeat"
    repeat: Repeats
    do: Steps

    @override
    def templates(self) -> Iterable[tuple[Keys, object]]:
        return (*super().templates(), (("repeat",), self.repeat))

    @override
    def numbers(self) -> Iterable[tuple[Keys, object, Wanted]]:
        return (*super().numbers(), (("repeat",), self.repeat, "count"))

    @override
    def loop_variable(self, check: ScopeCheck, scope: Scope) -> LoopVariable:
        passes = self.repeat if isinstance(self.repeat, int) else None
        return LoopVariable(INDEX, passes, check.is_static(self.repeat, scope))

    @override
    def robots_inside(self, check: RobotCheck, path: YamlPath, here: RobotScope, keys: Keys) -> RobotScope:
        values = range(self.repeat) if isinstance(self.repeat, int) else self._static_range(self.repeat, here)
        return replace(here, values=here.values.within(StaticLoop(INDEX, values)))

    def _static_range(self, text: str, here: RobotScope) -> Sequence[object] | None:
        """Return the numbers of the passes, if their count is known and the same for every robot."""
        expression = parse_template(text).whole
        if expression is None or not here.values.is_known(expression) or here.values.needs_facts([expression]):
            return None
        counts = {evaluate(expression, names) for names in here.values.combinations([expression])}
        return range(max((count for count in counts if isinstance(count, int)), default=0))

    @override
    def block_words(self, show: Show) -> str:
        return f"repeat {show(self.repeat)} times"

    @override
    def passes(self, scenario: Scenario) -> int | None:
        found = value_of_parameters(scenario, self.repeat)
        return found if isinstance(found, int) else None

    @override
    def perform_inside(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        count = yield from compute_count(run, context, self, path, self.repeat, "repeat")
        yield from self.perform_passes(run, context, path, INDEX, range(count or 0))


class WhileStep(LoopStep):
    """Perform steps as long as an expression is true; `${i}` is the number of the round, from 0."""

    kind = "while"
    while_: ExpressionText = Field(alias="while")
    """An expression, without `${}`."""
    limit: Repeats
    """Maximum number of rounds."""
    at_limit: Literal["fail", "go_on"] = "fail"
    """The outcome if the expression is still true after them."""
    do: Steps

    @override
    def templates(self) -> Iterable[tuple[Keys, object]]:
        return (*super().templates(), (("limit",), self.limit))

    @override
    def conditions(self) -> Iterable[tuple[Keys, object]]:
        return ((("while",), self.while_),)

    @override
    def numbers(self) -> Iterable[tuple[Keys, object, Wanted]]:
        return (*super().numbers(), (("limit",), self.limit, "count"))

    @override
    def check_values(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        check.unit(self.timeout_s, (*path, "timeout_s"), "s", "this")
        for keys, value in self.templates():
            check.template(value, (*path, *keys), scope)
        check.expression(self.while_, (*path, "while"), self.scope_inside(check, scope))  # it may use the index

    @override
    def loop_variable(self, check: ScopeCheck, scope: Scope) -> LoopVariable:
        return LoopVariable(INDEX, None, is_static=False)

    @override
    def robots_inside(self, check: RobotCheck, path: YamlPath, here: RobotScope, keys: Keys) -> RobotScope:
        guard = Guard(parse_bare(self.while_)[0], wanted=True)
        return replace(here, values=here.values.within(StaticLoop(INDEX, None)).under(guard))

    @override
    def block_words(self, show: Show) -> str:
        return f"while {self.while_}, at most {show(self.limit)} times"

    @override
    def passes(self, scenario: Scenario) -> None:
        return None

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
