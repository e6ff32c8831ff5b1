"""The calls of a scenario: the nine methods of the resource API and halt, and what happens when one fails."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Final, Literal

from pydantic import BeforeValidator, Discriminator, Field, NonNegativeFloat, PositiveFloat, PositiveInt, Tag

from eal_actors.scenario.variables import substitute, substitute_text
from eal_actors.strict_model import StrictModel
from eal_actors.yaml_tree import show

VARIABLE_PATTERN: Final = r"^[A-Za-z_][A-Za-z0-9_]*$"
TEXT_FIELDS: Final = ("cmd", "req", "key")
"""What a method takes as text, even if it reads like a number."""

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
Value = Annotated[bool | int | float | str | Scalars, BeforeValidator(_refuse_mapping)]
"""What a loop goes through, and what a call is given."""


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
    """File that keeps the answer, in the robot's folder of the run directory; its suffix tells how."""


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
