"""All steps there are, the blocks that hold steps, and how one is told from another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, TypeAlias

from pydantic import BeforeValidator, Discriminator, Field, Tag

from eal_actors.kernel.strict_model import NAMES_ONLY, Name, did_you_mean
from eal_actors.scenario.model.actions import ExpectStep, LetStep, LogStep, PythonStep, ScenarioStep
from eal_actors.scenario.model.base import BlockStep, Step
from eal_actors.scenario.model.calls import (
    CALLS,
    GetConfig,
    GetStatus,
    GetValue,
    Halt,
    ReadComm,
    SendCmd,
    SendReq,
    SetConfig,
    SetValue,
    WriteComm,
)
from eal_actors.scenario.model.values import ExpressionText, Text, Value, VariableName, WholeExpression
from eal_actors.scenario.model.waits import BarrierStep, SignalStep, WaitForStep, WaitStep, WaitUntilStep

INDEX: Final = "i"
"""The variable that counts a `repeat` or `while`, from 0."""
MAX_REPEATS: Final = 1_000_000


def _refuse_empty(value: object) -> object:
    if isinstance(value, list) and not value:
        raise ValueError("is empty; it needs at least one item")
    return value


NOT_EMPTY: Final = BeforeValidator(_refuse_empty)
"""In place of `min_length`, which pydantic finds violated as well when the items themselves are wrong."""
MIN_ITEMS: Final[dict[str, Any]] = {"minItems": 1}


def _refuse_other_than_one(value: object) -> object:
    if isinstance(value, Mapping) and len(value) != 1:
        raise ValueError(f"must name one variable, not {len(value)}; write a loop inside a loop for more")
    return value


LoopList = Annotated[tuple[Value, ...], Field(strict=False, json_schema_extra=MIN_ITEMS), NOT_EMPTY]


def _values_kind(value: object) -> str:
    return "expression" if isinstance(value, str) else "list"


LoopValues = Annotated[
    Annotated[LoopList, Tag("list")] | Annotated[WholeExpression, Tag("expression")], Discriminator(_values_kind)
]


# The blocks: steps that hold steps.


class OnStep(BlockStep):
    """Let every robot of a role go through steps, all robots at once; over when the last robot is through."""

    kind = "on"
    on: Name
    """The role."""
    do: Steps
    until: Text = "all"
    """`all`: over when everyone is through; `first`: when the first is; else the name of a signal. Who is not through
    by then is halted."""


class SequenceStep(BlockStep):
    """Go through steps one after the other: for what they have in common, such as a time-out."""

    kind = "sequence"
    sequence: Steps


class ParallelStep(BlockStep):
    """Go through several branches at once."""

    kind = "parallel"
    parallel: Branches
    """Lists of steps, or names to lists of steps."""
    until: Text = "all"
    """As with `on`."""


class ForStep(BlockStep):
    """Go through steps once for each value of a list."""

    kind = "for"
    for_: Annotated[dict[VariableName, LoopValues], BeforeValidator(_refuse_other_than_one)] = Field(
        alias="for", json_schema_extra={**NAMES_ONLY, "minProperties": 1, "maxProperties": 1}
    )
    """Name of the variable, and the values it takes: a list, or `${...}` that stands for one."""
    do: Steps

    @property
    def variable(self) -> str:
        """The variable."""
        return next(iter(self.for_))

    @property
    def values(self) -> tuple[object, ...] | str:
        """The values it takes."""
        return next(iter(self.for_.values()))


class RepeatStep(BlockStep):
    """Go through steps several times; `${i}` counts them from 0."""

    kind = "repeat"
    repeat: Annotated[
        Annotated[int, Field(ge=1, le=MAX_REPEATS), Tag("number")] | Annotated[WholeExpression, Tag("expression")],
        Discriminator(lambda value: "expression" if isinstance(value, str) and "${" in value else "number"),
    ]
    do: Steps


class WhileStep(BlockStep):
    """Go through steps as long as an expression is true; `${i}` counts the rounds from 0."""

    kind = "while"
    while_: ExpressionText = Field(alias="while")
    """An expression, without `${}`."""
    limit: Annotated[
        Annotated[int, Field(ge=1, le=MAX_REPEATS), Tag("number")] | Annotated[WholeExpression, Tag("expression")],
        Discriminator(lambda value: "expression" if isinstance(value, str) and "${" in value else "number"),
    ]
    """The most rounds."""
    at_limit: Literal["fail", "go_on"] = "fail"
    """What happens if it is still true after them."""
    do: Steps


class IfStep(BlockStep):
    """Go one way or another."""

    kind = "if"
    if_: ExpressionText = Field(alias="if")
    """An expression, without `${}`."""
    then: Steps
    else_: Steps | None = Field(default=None, alias="else")


_MODELS: Final[tuple[type[Step], ...]] = (
    OnStep,
    SequenceStep,
    ParallelStep,
    ForStep,
    RepeatStep,
    WhileStep,
    IfStep,
    WaitStep,
    WaitUntilStep,
    BarrierStep,
    SignalStep,
    WaitForStep,
    LetStep,
    ExpectStep,
    LogStep,
    PythonStep,
    ScenarioStep,
    *CALLS,
)
_STEPS: Final[dict[str, type[Step]]] = {model.kind: model for model in _MODELS}
_MODIFIERS: Final = frozenset(
    (
        *("do", "then", "else", "until", "limit", "at_limit", "with", "roles", "signals", "value", "count", "poll_s"),
        "default",
        *("timeout_s", "on_failure", "save", "save_as", "together", "equals", "tolerance", "says", "safe_to_repeat"),
    )
)
"""Keys that stand beside the one that tells what a step is."""


def _check_kind(value: object) -> object:
    """Refuse what is no step, or two at once, in words that help."""
    if isinstance(value, Mapping):
        kinds = [key for key in value if key in _STEPS]
        if len(kinds) > 1:
            raise ValueError(
                f"is {' and '.join(repr(kind) for kind in kinds)} at once; begin each step with its own '-'"
            )
        if not kinds:
            keys = [key for key in value if key not in _MODIFIERS]
            hint = did_you_mean(str(keys[0]), _STEPS) if keys else ""
            unknown = f"unknown step '{keys[0]}'{hint}" if keys else "is no step"
            raise ValueError(unknown if hint else f"{unknown}; a step is one of {', '.join(_STEPS)}")
    return value


def _kind(value: object) -> str:
    if isinstance(value, Mapping):
        return next(_STEPS[key].__name__ for key in value if key in _STEPS)
    return type(value).__name__ if isinstance(value, Step) else "LogStep"  # which then wants a mapping


AnyStep: TypeAlias = Annotated[
    Annotated[GetStatus, Tag("GetStatus")]
    | Annotated[GetValue, Tag("GetValue")]
    | Annotated[SetValue, Tag("SetValue")]
    | Annotated[SendReq, Tag("SendReq")]
    | Annotated[SendCmd, Tag("SendCmd")]
    | Annotated[ReadComm, Tag("ReadComm")]
    | Annotated[WriteComm, Tag("WriteComm")]
    | Annotated[GetConfig, Tag("GetConfig")]
    | Annotated[SetConfig, Tag("SetConfig")]
    | Annotated[Halt, Tag("Halt")]
    | Annotated[OnStep, Tag("OnStep")]
    | Annotated[SequenceStep, Tag("SequenceStep")]
    | Annotated[ParallelStep, Tag("ParallelStep")]
    | Annotated[ForStep, Tag("ForStep")]
    | Annotated[RepeatStep, Tag("RepeatStep")]
    | Annotated[WhileStep, Tag("WhileStep")]
    | Annotated[IfStep, Tag("IfStep")]
    | Annotated[WaitStep, Tag("WaitStep")]
    | Annotated[WaitUntilStep, Tag("WaitUntilStep")]
    | Annotated[BarrierStep, Tag("BarrierStep")]
    | Annotated[SignalStep, Tag("SignalStep")]
    | Annotated[WaitForStep, Tag("WaitForStep")]
    | Annotated[LetStep, Tag("LetStep")]
    | Annotated[ExpectStep, Tag("ExpectStep")]
    | Annotated[LogStep, Tag("LogStep")]
    | Annotated[PythonStep, Tag("PythonStep")]
    | Annotated[ScenarioStep, Tag("ScenarioStep")],
    Discriminator(_kind),
    BeforeValidator(_check_kind),
]
Steps: TypeAlias = Annotated[tuple[AnyStep, ...], Field(strict=False, json_schema_extra=MIN_ITEMS), NOT_EMPTY]


def _branches_kind(value: object) -> str:
    return "named" if isinstance(value, Mapping) else "listed"


def _refuse_no_branch(value: object) -> object:
    if isinstance(value, Mapping) and not value:
        raise ValueError("is empty; it needs at least one branch")
    return value


Branches: TypeAlias = Annotated[
    Annotated[tuple[Steps, ...], Field(strict=False, json_schema_extra=MIN_ITEMS), NOT_EMPTY, Tag("listed")]
    | Annotated[
        dict[Name, Steps],
        BeforeValidator(_refuse_no_branch),
        Field(json_schema_extra={**NAMES_ONLY, "minProperties": 1}),
        Tag("named"),
    ],
    Discriminator(_branches_kind),
]


def inner_steps(step: Step) -> tuple[tuple[tuple[str | int, ...], tuple[AnyStep, ...]], ...]:
    """Return the lists of steps that a step holds, each with the keys that lead to it."""
    if isinstance(step, ParallelStep):
        branches = step.parallel
        items = branches.items() if isinstance(branches, dict) else enumerate(branches)
        return tuple((("parallel", name), steps) for name, steps in items)
    if isinstance(step, IfStep):
        return ((("then",), step.then), *(((("else",), step.else_),) if step.else_ is not None else ()))
    if isinstance(step, SequenceStep):
        return ((("sequence",), step.sequence),)
    if isinstance(step, OnStep | ForStep | RepeatStep | WhileStep):
        return ((("do",), step.do),)
    return ()
