"""The types of the fields of steps: plain values, values with `${...}`, and what happens when a step fails."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, Discriminator, Field, NonNegativeFloat, PositiveFloat, PositiveInt, Tag

from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.strict_model import StrictModel
from eal_actors.kernel.yaml_tree import show
from eal_actors.scenario.language.expressions.functions import as_text
from eal_actors.scenario.language.expressions.grammar import parse_template
from eal_actors.scenario.language.wording import short_value

VARIABLE_PATTERN: Final = r"^[A-Za-z_][A-Za-z0-9_]*$"
MAX_REPEATS: Final = 1_000_000
INDEX: Final = "i"
"""The variable that counts the passes of `repeat` and `while`, from 0."""

Text = Annotated[str, Field(min_length=1)]
VariableName = Annotated[str, Field(pattern=VARIABLE_PATTERN)]


def not_empty(kind: type[list[Any] | dict[Any, Any]], needed: str) -> BeforeValidator:
    """Return a replacement of `min_length`: pydantic reports that as violated too when only the items are wrong."""

    def refuse_empty(value: object) -> object:
        if isinstance(value, kind) and not value:
            raise ValueError(f"is empty; it needs at least one {needed}")
        return value

    return BeforeValidator(refuse_empty)


NOT_EMPTY: Final = not_empty(list, "item")
MIN_ITEMS: Final[dict[str, Any]] = {"minItems": 1}


# Plain values.


def _refuse_structure(value: object) -> object:
    if value is None or isinstance(value, Mapping | list):
        raise ValueError(f"must be text, a number, true or false, not {show(value)}")
    return value


def _refuse_mapping(value: object) -> object:
    if value is None or isinstance(value, Mapping):
        raise ValueError(f"must be text, a number, true, false or a list of them, not {show(value)}")
    return value


Scalar = Annotated[bool | int | float | str, BeforeValidator(_refuse_structure)]
Scalars = Annotated[tuple[Scalar, ...], Field(strict=False)]
_Plain = Annotated[bool | int | float | str, Tag("scalar")]
_ListOrPlain: Final = Discriminator(lambda value: "list" if isinstance(value, list | tuple) else "scalar")
_Item = Annotated[_Plain | Annotated[Scalars, Tag("list")], _ListOrPlain, BeforeValidator(_refuse_mapping)]
_Items = Annotated[tuple[_Item, ...], Field(strict=False)]
Value = Annotated[_Plain | Annotated[_Items, Tag("list")], _ListOrPlain, BeforeValidator(_refuse_mapping)]
"""A value of a loop or of a call. A list may hold lists, such as waypoints `[[x, y], ...]`."""


# Values with expressions.


def _expression_only(value: object) -> object:
    if isinstance(value, str) and parse_template(value).whole is None:
        raise ValueError(f"must be a number, or ${{...}} and nothing around it, not {show(value)}")
    return value


WholeExpression = Annotated[
    str, BeforeValidator(_expression_only), Field(json_schema_extra={"pattern": r"^\$\{[\s\S]*\}$"})
]
"""A text that is one `${...}`. It becomes the value of the expression."""


ExpressionText = Annotated[
    str,
    BeforeValidator(lambda value: str(value).lower() if isinstance(value, bool) else value),
    Field(min_length=1, json_schema_extra={"type": ["string", "boolean"]}),
]
"""An expression without `${}`. `true` and `false` need no quotes."""

_Kind: Final = Discriminator(lambda value: "expression" if isinstance(value, str) and "${" in value else "number")
_Expression = Annotated[WholeExpression, Tag("expression")]

Seconds = Annotated[Annotated[NonNegativeFloat, Tag("number")] | _Expression, _Kind]
"""Seconds of the fleet's clock, from 0."""
Timeout = Annotated[Annotated[PositiveFloat, Tag("number")] | _Expression, _Kind]
"""Seconds of the fleet's clock, over 0."""
Count = Annotated[Annotated[int, Field(ge=1, le=MAX_REPEATS), Tag("number")] | _Expression, _Kind]
"""A whole number from 1 to MAX_REPEATS."""

Wanted = Literal["seconds", "timeout", "count"]
"""The range of a number: seconds from 0, seconds over 0, or a whole number from 1."""

Held = Literal[Wanted, "template", "condition", "variable"]
"""The content of a field of a step: a number, or `${...}` that evaluates to one; another value with `${...}`; an
expression without `${}`; or the name of a variable that the step assigns."""


def number_problem(value: object, wanted: Wanted) -> str | None:
    """Return why the value of an expression cannot be such a number, or None."""
    if wanted == "count":
        fits = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MAX_REPEATS
        return None if fits else f"must be a whole number from 1 to {MAX_REPEATS}, not {_format(value)}"
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) <= sys.float_info.max:
        return f"must be a number, not {_format(value)}"
    if wanted == "timeout" and not value > 0:
        return f"must be over 0, not {_format(value)}"
    return f"must be at least 0, not {_format(value)}" if value < 0 else None


def checked_number(value: object, wanted: Wanted, what: str) -> float:
    """Return a number that was computed during the run; raise ScenarioError if it is out of the wanted range."""
    if (problem := number_problem(value, wanted)) is not None:
        raise ScenarioError(f"{what} {problem}")
    return value  # type: ignore[return-value]  # it is a number


def _format(value: object) -> str:
    return as_text(value) if isinstance(value, bool | float) else short_value(value)


FailureAction = Literal["abort", "drop", "skip", "substitute"]


class RetryPolicy(StrictModel):
    """Try again before giving up."""

    retry: PositiveInt
    """How many more attempts."""
    back_off_s: NonNegativeFloat = 0.0
    """Pause before the next attempt, in seconds of the fleet's clock."""
    factor: float = Field(default=1.0, ge=1.0, le=10.0)
    """The pause grows by this factor from attempt to attempt."""
    then: FailureAction = "abort"
    """The action when the last attempt has failed."""

    def pause_s(self, attempt: int) -> float:
        """Return the pause after a failed attempt, counted from 1."""
        return self.back_off_s * self.factor ** min(attempt - 1, 100)


OnFailure = Annotated[
    Annotated[FailureAction, Tag("Action")] | Annotated[RetryPolicy, Tag("RetryPolicy")],
    Discriminator(lambda value: "RetryPolicy" if isinstance(value, Mapping | RetryPolicy) else "Action"),
]
"""`abort` ends the run, `drop` continues without the robot, `skip` continues with the next step, `substitute` lets a
spare of the role take the robot's place."""


LossAction = Literal["fail", "drop", "substitute"]


class WaitPolicy(StrictModel):
    """Wait for a lost robot before giving it up."""

    wait_s: PositiveFloat
    """How long, in seconds of the fleet's clock, after its step has failed."""
    rejoin: bool = False
    """When it is back, it leaves out its steps up to its next meeting. Otherwise it repeats the step that failed."""
    then: LossAction = "fail"
    """The action if it is not back in time."""


OnLost = Annotated[
    Annotated[LossAction, Tag("Action")] | Annotated[WaitPolicy, Tag("WaitPolicy")],
    Discriminator(lambda value: "WaitPolicy" if isinstance(value, Mapping | WaitPolicy) else "Action"),
]
"""`fail` ends the run; `drop` and `substitute` are those of OnFailure."""


def final_action(policy: FailureAction | RetryPolicy) -> FailureAction:
    """Return the action of a policy when no attempt is left."""
    return policy.then if isinstance(policy, RetryPolicy) else policy
