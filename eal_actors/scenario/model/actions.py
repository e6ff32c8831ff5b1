"""Steps that are neither calls nor waits nor blocks: variables, expectations, words, code and other scenarios."""

from __future__ import annotations

from typing import Annotated, Any, Final

from pydantic import BeforeValidator, Field, NonNegativeFloat

from eal_actors.kernel.strict_model import NAMES_ONLY, Name
from eal_actors.scenario.model.base import BlockStep, FallibleStep, TimedStep
from eal_actors.scenario.model.values import ExpressionText, Text, Value, VariableName


def _refuse_empty(value: object) -> object:
    if isinstance(value, dict) and not value:
        raise ValueError("is empty; it needs at least one name")
    return value


_NAMED: Final[dict[str, Any]] = {**NAMES_ONLY, "minProperties": 1}
Named = Annotated[dict[VariableName, Value], BeforeValidator(_refuse_empty), Field(json_schema_extra=_NAMED)]


class LetStep(FallibleStep):
    """Give variables a value: the robot's own inside an `on`, those of the run outside."""

    kind = "let"
    let: Named
    """Name to an expression, without `${}`; a list holds expressions. A text as such stands in quotes of its own."""


class ExpectStep(FallibleStep):
    """Fail unless something is as expected."""

    kind = "expect"
    expect: ExpressionText
    """An expression, without `${}`, that must be true, or equal to `equals`."""
    equals: Value | None = None
    tolerance: NonNegativeFloat | None = None
    """By how much numbers may differ from `equals`."""
    says: Text | None = None
    """What to tell if it is not so."""


class LogStep(FallibleStep):
    """Tell those who watch the run."""

    kind = "log"
    log: Text


class PythonStep(TimedStep):
    """Run a function of Python in a thread of its own."""

    kind = "python"
    python: Text
    """An entry point of the group `eal_actors.steps`, or `module:function` if the fleet file allows it."""
    with_: dict[VariableName, Value] = Field(default={}, alias="with", json_schema_extra=NAMES_ONLY)
    """The function's arguments by name."""
    save_as: VariableName | None = None
    """Variable that keeps what it returns."""


class ScenarioStep(BlockStep):
    """Carry out another scenario, with variables of its own; inside an `on` each robot by itself, in all of its roles.

    `on_failure` is for its parameters and for its time-out: what its steps do when they fail, it says itself.
    """

    kind = "scenario"
    scenario: Text
    """Its file, relative to this one."""
    with_: dict[VariableName, Value] = Field(default={}, alias="with", json_schema_extra=NAMES_ONLY)
    """Its parameters."""
    roles: dict[Name, Name] = Field(default={}, json_schema_extra=NAMES_ONLY)
    """Its roles to roles of this scenario; those left out go by the same name. Not inside an `on`."""
    signals: dict[Name, Name] = Field(default={}, json_schema_extra=NAMES_ONLY)
    """Its signals to signals of this scenario that are given with them."""
