"""What a scenario file may say.

A step is a mapping with one key that tells what it is. Whatever takes a value takes `${name}` in its texts too.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Final, Literal, TypeAlias

from pydantic import BeforeValidator, Discriminator, Field, NonNegativeFloat, PositiveFloat, PositiveInt, Tag

from eal_actors.scenario.variables import substitute, substitute_text
from eal_actors.strict_model import NAMES_ONLY, Name, StrictModel, Version1, did_you_mean
from eal_actors.yaml_tree import show

VARIABLE_PATTERN: Final = r"^[A-Za-z_][A-Za-z0-9_]*$"
INDEX: Final = "i"
"""The variable that counts a `repeat`, from 0."""
TEXT_FIELDS: Final = ("cmd", "req", "key")
"""What a method takes as text, even if it reads like a number."""
MAX_REPEATS: Final = 1_000_000

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


def _refuse_empty(value: object) -> object:
    if isinstance(value, list) and not value:
        raise ValueError("is empty; it needs at least one item")
    return value


_NOT_EMPTY: Final = BeforeValidator(_refuse_empty)
"""In place of `min_length`, which pydantic finds violated as well when the items themselves are wrong."""
_MIN_ITEMS: Final[dict[str, Any]] = {"minItems": 1}


Scalar = Annotated[bool | int | float | str, BeforeValidator(_refuse_structure)]
Scalars = Annotated[tuple[Scalar, ...], Field(strict=False)]
Value = Annotated[bool | int | float | str | Scalars, BeforeValidator(_refuse_mapping)]
"""What a loop goes through, and what a call is given."""


LoopValues = Annotated[tuple[Value, ...], Field(strict=False, json_schema_extra=_MIN_ITEMS), _NOT_EMPTY]


def _refuse_other_than_one(value: object) -> object:
    if isinstance(value, Mapping) and len(value) != 1:
        raise ValueError(f"must name one variable, not {len(value)}; write a loop inside a loop for more")
    return value


# What happens when a call fails.

Action = Literal["abort", "drop"]


class RetryPolicy(StrictModel):
    """Try again before giving up."""

    retry: PositiveInt
    """How many more attempts."""
    back_off_s: NonNegativeFloat = 0.0
    """Pause before each of them, in seconds of the fleet's clock."""
    then: Action = "abort"
    """What to do when the last attempt has failed."""


def _policy_kind(value: object) -> str:
    return "RetryPolicy" if isinstance(value, Mapping | RetryPolicy) else "Action"


OnFailure = Annotated[
    Annotated[Action, Tag("Action")] | Annotated[RetryPolicy, Tag("RetryPolicy")], Discriminator(_policy_kind)
]
"""`abort` ends the run, `drop` goes on without the robot."""


# The calls: the nine methods of the resource API under their own names, and halt.


class ResourceArguments(StrictModel):
    """What a call is given: the resource, and under the API's names what the method takes."""

    resource: Text
    """Name of the resource on the robot."""


class ValueArguments(ResourceArguments):
    """For set_value."""

    value: Value


class RequestArguments(ResourceArguments):
    """For send_req."""

    req: Text


class CommandArguments(ResourceArguments):
    """For send_cmd."""

    cmd: Text
    data: Value | None = None


class ReadArguments(ResourceArguments):
    """For read_comm."""

    length: PositiveInt
    """Bytes to read at most."""


class WriteArguments(ResourceArguments):
    """For write_comm."""

    data: Value
    length: PositiveInt | None = None
    """Bytes to write; all if left out."""


class KeyArguments(ResourceArguments):
    """For get_config."""

    key: Text


class ConfigArguments(KeyArguments):
    """For set_config."""

    value: Value | None = None


class CallStep(StrictModel):
    """A call of one robot's resource; the step is over when it is answered."""

    method: ClassVar[str]
    timeout_s: PositiveFloat | None = None
    """Deadline of each attempt, in seconds of the fleet's clock."""
    on_failure: OnFailure | None = None
    """Overrides the scenario's."""

    @property
    def arguments(self) -> ResourceArguments:
        """What the call is given."""
        found: ResourceArguments = getattr(self, self.method)
        return found


class AnswerStep(CallStep):
    """A call that is answered with a value."""

    save_as: VariableName | None = None
    """Variable that keeps the answer, for the later steps of the same role."""
    save: Text | None = None
    """File that keeps the answer, in the robot's folder of the run directory: a PNG where it is an image."""


class GetStatus(CallStep):
    """Ask for the status."""

    method = "get_status"
    get_status: ResourceArguments


class GetValue(AnswerStep):
    """Ask for the value."""

    method = "get_value"
    get_value: ResourceArguments


class SetValue(CallStep):
    """Set the value."""

    method = "set_value"
    set_value: ValueArguments


class SendReq(AnswerStep):
    """Send a request."""

    method = "send_req"
    send_req: RequestArguments


class SendCmd(CallStep):
    """Send a command; the step is over when the command is."""

    method = "send_cmd"
    send_cmd: CommandArguments


class ReadComm(AnswerStep):
    """Read bytes."""

    method = "read_comm"
    read_comm: ReadArguments


class WriteComm(CallStep):
    """Write bytes."""

    method = "write_comm"
    write_comm: WriteArguments


class GetConfig(AnswerStep):
    """Ask for a configuration value."""

    method = "get_config"
    get_config: KeyArguments


class SetConfig(CallStep):
    """Set a configuration value."""

    method = "set_config"
    set_config: ConfigArguments


class Halt(CallStep):
    """Stop what moves, at once."""

    method = "halt"
    halt: ResourceArguments


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
    description: Text
    """One line for people."""
    roles: dict[Name, RoleSection] = Field(min_length=1, json_schema_extra=NAMES_ONLY)
    timeout_s: PositiveFloat | None = None
    """Deadline of a call that gives none; the fleet file's if left out. In seconds of the fleet's clock."""
    on_failure: OnFailure = "abort"
    """What happens when a call fails."""
    steps: Steps
    finally_: Annotated[tuple[Step, ...], Field(strict=False)] = Field(default=(), alias="finally")
    """Steps for the end, whatever came before it; all robots take part, and a failure stops none of them."""


def final_action(policy: Action | RetryPolicy) -> Action:
    """Return what a policy does when no attempt is left."""
    return policy.then if isinstance(policy, RetryPolicy) else policy


def call_fields(step: CallStep) -> dict[str, Any]:
    """Return what a call gives its method beside the resource, by the API's names and in its order."""
    arguments = step.arguments
    return {name: getattr(arguments, name) for name in type(arguments).model_fields if name != "resource"}


def resolved_fields(step: CallStep, variables: Mapping[str, object]) -> dict[str, Any]:
    """Return the same with variables put in.

    Raises:
        ScenarioError: a variable has no value, or one that cannot stand inside a text.
    """
    return {
        name: substitute_text(value, variables) if name in TEXT_FIELDS else substitute(value, variables)
        for name, value in call_fields(step).items()
    }
