"""The steps that take no time: `expect`, `let`, `log` and `signal`."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Any, Final

from pydantic import BeforeValidator, Field, NonNegativeFloat
from typing_extensions import override

from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.strict_model import NAMES_ONLY, Name
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.executor import StepAction
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions import (
    bare_expressions,
    evaluate,
    evaluate_bare,
    expressions_in,
    parse_bare,
    render,
    render_text,
    to_plain,
)
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.values import ExpressionText, Text, Value, VariableName
from eal_actors.scenario.report.events import Signalled
from eal_actors.scenario.report.records import to_view
from eal_actors.scenario.steps.base import FallibleStep, Keys, Show
from eal_actors.scenario.steps.wording import describe_names, short_value


class ExpectStep(FallibleStep):
    """Fail unless an expression is true, or has a value."""

    kind = "expect"
    is_expectation = True
    expect: ExpressionText
    """An expression, without `${}`, that must be true, or equal to `equals`."""
    equals: Value | None = None
    tolerance: NonNegativeFloat | None = None
    """Maximum difference of numbers from `equals`."""
    says: Text | None = None
    """The beginning of the message on failure."""

    @override
    def templates(self) -> Iterable[tuple[Keys, object]]:
        return ((("equals",), self.equals), (("says",), self.says))

    @override
    def conditions(self) -> Iterable[tuple[Keys, object]]:
        return ((("expect",), self.expect),)

    @override
    def check_placement(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        super().check_placement(check, path, scope)
        if self.tolerance is not None and self.equals is None:
            check.report((*path, "tolerance"), "has no meaning without 'equals'", key=True)
        elif self.tolerance is not None and isinstance(self.equals, bool):
            check.report((*path, "tolerance"), "has no meaning for true and false", key=True)

    @override
    def words(self, show: Show) -> str:
        tolerance = f" ± {self.tolerance:g}" if self.tolerance else ""
        equals = f" to be {show(self.equals)}{tolerance}" if self.equals is not None else ""
        return f"expect {self.expect}{equals}"

    @override
    def attempt(self, action: StepAction) -> Coroutine:
        expression, _ = parse_bare(self.expect)
        expressions = [expression, *expressions_in((self.equals, self.says))]
        names = yield from action.run.read(action.context, expressions)
        found = to_plain(evaluate(expression, names), self.expect)
        if self.equals is None:
            is_right, wanted = bool(found), "to be true"
        else:
            target = to_plain(render(self.equals, names), "equals")
            is_right = _is_equal(found, target, self.tolerance or 0.0)
            around = f" ± {self.tolerance:g}" if self.tolerance else ""
            wanted = f"to be {short_value(target)}{around}"
        if not is_right:
            says = f"{render_text(self.says, names)}: " if self.says is not None else ""
            seen = describe_names(expression, names) if self.equals is None else f", but it is {short_value(found)}"
            raise ScenarioError(f"{says}expected {self.expect} {wanted}{seen}")


def _is_equal(found: Any, wanted: Any, tolerance: float) -> bool:
    if isinstance(found, list | tuple) and isinstance(wanted, list | tuple):
        pairs = list(zip(found, wanted, strict=False))
        return len(found) == len(wanted) and all(_is_equal(one, other, tolerance) for one, other in pairs)
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in (found, wanted)):
        return bool(math.isclose(found, wanted, rel_tol=0.0, abs_tol=tolerance + 1e-12 * tolerance))
    return bool(type(found) is type(wanted) and found == wanted)


def _refuse_empty(value: object) -> object:
    if isinstance(value, dict) and not value:
        raise ValueError("is empty; it needs at least one name")
    return value


_NAMED: Final[dict[str, Any]] = {**NAMES_ONLY, "minProperties": 1}
Named = Annotated[dict[VariableName, Value], BeforeValidator(_refuse_empty), Field(json_schema_extra=_NAMED)]


class LetStep(FallibleStep):
    """Assign variables: the robot's own inside an `on`, those of the run outside."""

    kind = "let"
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
            names = yield from action.run.read(action.context, bare_expressions(value))
            action.run.assign(action.context, name, evaluate_bare(value, names))


class LogStep(FallibleStep):
    """Send a line of text to those who watch the run."""

    kind = "log"
    is_instant = True
    log: Text

    @override
    def templates(self) -> Iterable[tuple[Keys, object]]:
        return ((("log",), self.log),)

    @property
    @override
    def label(self) -> str:
        return self.kind  # the text is in an event of its own

    @override
    def words(self, show: Show) -> str:
        return f"log {show(self.log)}"

    @override
    def attempt(self, action: StepAction) -> Coroutine:
        names = yield from action.read(self.log)
        action.run.log(action.context.robot_name, render_text(self.log, names))


class SignalStep(FallibleStep):
    """Give a signal to all who wait for it, now or later."""

    kind = "signal"
    is_instant = True
    signal: Name
    value: Value | None = None
    """The value that `wait_for` saves; defaults to the robot's name."""

    @override
    def given_signals(self) -> Iterable[str]:
        return (self.signal,)

    @override
    def templates(self) -> Iterable[tuple[Keys, object]]:
        return ((("value",), self.value),)

    @override
    def words(self, show: Show) -> str:
        return f"give signal {self.signal}"

    @override
    def attempt(self, action: StepAction) -> Coroutine:
        robot = action.context.robot_name
        value: Any = robot
        if self.value is not None:
            names = yield from action.read(self.value)
            value = render(self.value, names)
        frame, name = action.context.frame, self.signal
        while True:
            count = action.run.signals.give(frame, name, value)
            event = (robot, f"{frame.prefix}{name}", count, to_view(value))
            action.run.emit(lambda time_s, event=event: Signalled(time_s, *event))  # type: ignore[misc]
            if frame.outer is None or name not in frame.signals:
                return
            frame, name = frame.outer, frame.signals[name]
