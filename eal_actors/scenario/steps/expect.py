"""The step `expect`: fail unless a condition holds."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, NonNegativeFloat
from typing_extensions import override

from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions.evaluation import (
    evaluate,
    evaluate_bare,
    expressions_in,
    parse_bare,
    render_text,
    to_plain,
)
from eal_actors.scenario.language.robot_check import RobotCheck, RobotScope
from eal_actors.scenario.language.scenario import Show
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.values import ExpressionText, Held, Text, Value
from eal_actors.scenario.language.wording import describe_names, short_value
from eal_actors.scenario.steps.base import FallibleStep


def _refuse_nothing(value: object) -> object:
    if value is None:
        raise ValueError("is empty; leave it out to expect that the expression is true")
    return value


class ExpectStep(FallibleStep, kind="expect"):
    """Fail unless an expression is true, or has a value."""

    is_expectation = True
    holds: ClassVar[Mapping[str, Held]] = {"expect": "condition", "equals": "condition", "says": "template"}
    expect: ExpressionText
    """An expression, without `${}`, that must be true, or equal to `equals`."""
    equals: Annotated[Value | None, BeforeValidator(_refuse_nothing)] = None
    """An expression, without `${}`, or a list of them; a text needs quotes of its own."""
    tolerance: NonNegativeFloat | None = None
    """Maximum difference of numbers from `equals`."""
    says: Text | None = None
    """The beginning of the message on failure."""

    @override
    def check_placement(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        super().check_placement(check, path, scope)
        if self.tolerance is not None and self.equals is None:
            check.report((*path, "tolerance"), "has no meaning without 'equals'", key=True)
        elif self.tolerance is not None and isinstance(self.equals, bool):
            check.report((*path, "tolerance"), "has no meaning for true and false", key=True)

    @override
    def check_robots(self, check: RobotCheck, path: YamlPath, here: RobotScope) -> None:
        super().check_robots(check, path, here)
        if self.says is not None:
            check.text(self.says, (*path, "says"), here)

    @override
    def words(self, show: Show) -> str:
        tolerance = f" ± {self.tolerance:g}" if self.tolerance else ""
        equals = f" to be {show(self.equals)}{tolerance}" if self.equals is not None else ""
        return f"expect {self.expect}{equals}"

    @override
    def attempt(self, action: StepAction) -> Coroutine:
        expression, _ = parse_bare(self.expect)
        expressions = [expression, *expressions_in(self.equals, is_bare=True), *expressions_in(self.says)]
        names = yield from action.run.read(action.context, expressions)
        found = to_plain(evaluate(expression, names), self.expect)
        if self.equals is None:
            is_right, wanted = bool(found), "to be true"
        else:
            target = to_plain(evaluate_bare(self.equals, names), "equals")
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
        with suppress(OverflowError):  # of a whole number that no float can hold
            return bool(found == wanted or abs(found - wanted) <= tolerance + 1e-12 * tolerance)
        return False
    return bool(type(found) is type(wanted) and found == wanted)
