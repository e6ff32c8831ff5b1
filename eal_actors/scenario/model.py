"""What a scenario file may say.

A step is a mapping with one key that tells what it is. Whatever takes a value takes `${name}` in its texts too.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, TypeAlias

from pydantic import BeforeValidator, Discriminator, Field, NonNegativeFloat, PositiveFloat, PositiveInt, Tag

from eal_actors.scenario.calls import (
    GetConfig,
    GetStatus,
    GetValue,
    Halt,
    OnFailure,
    ReadComm,
    SendCmd,
    SendReq,
    SetConfig,
    SetValue,
    Text,
    Value,
    VariableName,
    WriteComm,
)
from eal_actors.strict_model import NAMES_ONLY, Name, StrictModel, Version1, did_you_mean

INDEX: Final = "i"
"""The variable that counts a `repeat`, from 0."""
MAX_REPEATS: Final = 1_000_000


def _refuse_empty(value: object) -> object:
    if isinstance(value, list) and not value:
        raise ValueError("is empty; it needs at least one item")
    return value


_NOT_EMPTY: Final = BeforeValidator(_refuse_empty)
"""In place of `min_length`, which pydantic finds violated as well when the items themselves are wrong."""
_MIN_ITEMS: Final[dict[str, Any]] = {"minItems": 1}


LoopValues = Annotated[tuple[Value, ...], Field(strict=False, json_schema_extra=_MIN_ITEMS), _NOT_EMPTY]


def _refuse_other_than_one(value: object) -> object:
    if isinstance(value, Mapping) and len(value) != 1:
        raise ValueError(f"must name one variable, not {len(value)}; write a loop inside a loop for more")
    return value


# The steps that are no calls.


class OnStep(StrictModel):
    """Let every robot of a role go through steps, all robots at once; over when the last robot is through."""

    on: Name
    """The role."""
    do: Steps


class ForStep(StrictModel):
    """Go through steps once for each value of a list."""

    for_: Annotated[dict[VariableName, LoopValues], BeforeValidator(_refuse_other_than_one)] = Field(
        alias="for", json_schema_extra={**NAMES_ONLY, "minProperties": 1, "maxProperties": 1}
    )
    """Name of the variable, and the values it takes."""
    do: Steps

    @property
    def loop(self) -> tuple[str, tuple[object, ...]]:
        """The variable, and the values it takes."""
        return next(iter(self.for_.items()))


class RepeatStep(StrictModel):
    """Go through steps several times; `${i}` counts them from 0."""

    repeat: int = Field(ge=1, le=MAX_REPEATS)
    do: Steps

    @property
    def loop(self) -> tuple[str, range]:
        """The variable, and the values it takes."""
        return INDEX, range(self.repeat)


class WaitStep(StrictModel):
    """Let time pass."""

    wait_s: NonNegativeFloat
    """Seconds of the fleet's clock."""


class LogStep(StrictModel):
    """Tell those who watch the run."""

    log: Text


_STEPS: Final[dict[str, type[StrictModel]]] = {
    "on": OnStep,
    "for": ForStep,
    "repeat": RepeatStep,
    "wait_s": WaitStep,
    "log": LogStep,
    "halt": Halt,
    **{
        model.method: model
        for model in (GetStatus, GetValue, SetValue, SendReq, SendCmd, ReadComm, WriteComm, GetConfig, SetConfig)
    },
}


def _check_kind(value: object) -> object:
    """Refuse what is no step, or two at once, in words that help."""
    if isinstance(value, Mapping):
        kinds = [key for key in value if key in _STEPS]
        if len(kinds) > 1:
            raise ValueError(
                f"is {' and '.join(repr(kind) for kind in kinds)} at once; begin each step with its own '-'"
            )
        if not kinds:
            keys = [key for key in value if key not in ("do", "timeout_s", "on_failure", "save", "save_as")]
            hint = did_you_mean(str(keys[0]), _STEPS) if keys else ""
            unknown = f"unknown step '{keys[0]}'{hint}" if keys else "is no step"
            raise ValueError(unknown if hint else f"{unknown}; a step is one of {', '.join(_STEPS)}")
    return value


def _kind(value: object) -> str:
    if isinstance(value, Mapping):
        return next(_STEPS[key].__name__ for key in value if key in _STEPS)
    return type(value).__name__ if isinstance(value, StrictModel) else "LogStep"  # which then wants a mapping


Call: TypeAlias = (
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
)
Step: TypeAlias = Annotated[
    Call
    | Annotated[OnStep, Tag("OnStep")]
    | Annotated[ForStep, Tag("ForStep")]
    | Annotated[RepeatStep, Tag("RepeatStep")]
    | Annotated[WaitStep, Tag("WaitStep")]
    | Annotated[LogStep, Tag("LogStep")],
    Discriminator(_kind),
    BeforeValidator(_check_kind),
]
Steps: TypeAlias = Annotated[tuple[Step, ...], Field(strict=False, json_schema_extra=_MIN_ITEMS), _NOT_EMPTY]

for _model in (OnStep, ForStep, RepeatStep):
    _model.model_rebuild()


# The file.

_Words = Annotated[tuple[Text, ...], Field(strict=False, json_schema_extra=_MIN_ITEMS), _NOT_EMPTY]


class RoleSection(StrictModel):
    """Which robots of the fleet take the role: those that fit everything given, all if nothing is."""

    tags: _Words | None = None
    """They have one of these tags."""
    types: _Words | None = None
    """Their type is, or builds on, one of these."""
    robots: _Words | None = None
    """They have one of these names."""
    min: PositiveInt = 1
    """With fewer robots the scenario does not start."""


class ScenarioFile(StrictModel):
    """A scenario file."""

    version: Version1
    name: Name
    description: str = ""
    """One line for people."""
    roles: dict[Name, RoleSection] = Field(min_length=1, json_schema_extra=NAMES_ONLY)
    timeout_s: PositiveFloat | None = None
    """Deadline of a call that gives none; the fleet file's if left out. In seconds of the fleet's clock."""
    on_failure: OnFailure = "abort"
    """What happens when a call fails."""
    steps: Steps
    finally_: Annotated[tuple[Step, ...], Field(strict=False)] = Field(default=(), alias="finally")
    """Steps for the end, whatever came before it; all robots take part, and a failure stops none of them."""
