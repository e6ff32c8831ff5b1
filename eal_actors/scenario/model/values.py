"""The values that steps are given: plain, or worked out from `${...}` when the step is reached."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Final

from pydantic import BeforeValidator, Discriminator, Field, NonNegativeFloat, PositiveFloat, PositiveInt, Tag

from eal_actors.kernel.yaml_tree import show

VARIABLE_PATTERN: Final = r"^[A-Za-z_][A-Za-z0-9_]*$"
_EXPRESSION: Final = re.compile(r"\$\{.*\}", re.DOTALL)

Text = Annotated[str, Field(min_length=1)]
VariableName = Annotated[str, Field(pattern=VARIABLE_PATTERN)]


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
"""What a loop goes through, and what a call is given: a list may hold lists, such as waypoints `[[x, y], ...]`."""


def _expression_only(value: object) -> object:
    if isinstance(value, str) and not _EXPRESSION.fullmatch(value):
        raise ValueError(f"must be a number, or ${{...}} and nothing around it, not {show(value)}")
    return value


WholeExpression = Annotated[
    str, BeforeValidator(_expression_only), Field(json_schema_extra={"pattern": r"^\$\{[\s\S]*\}$"})
]
"""A text that is one `${...}`: it becomes what the expression stands for."""


def _truth_in_words(value: object) -> object:
    return {True: "true", False: "false"}[value] if isinstance(value, bool) else value


ExpressionText = Annotated[
    str,
    BeforeValidator(_truth_in_words),
    Field(min_length=1, json_schema_extra={"type": ["string", "boolean"]}),
]
"""An expression by itself, without `${}`; `true` and `false` need no quotes."""


def _number_kind(value: object) -> str:
    return "expression" if isinstance(value, str) and "${" in value else "number"


_Kind: Final = Discriminator(_number_kind)
_Expression = Annotated[WholeExpression, Tag("expression")]

Seconds = Annotated[Annotated[NonNegativeFloat, Tag("number")] | _Expression, _Kind]
"""Seconds of the fleet's clock, from 0."""
Timeout = Annotated[Annotated[PositiveFloat, Tag("number")] | _Expression, _Kind]
"""Seconds of the fleet's clock, over 0."""
Count = Annotated[Annotated[PositiveInt, Tag("number")] | _Expression, _Kind]
"""A whole number from 1."""
