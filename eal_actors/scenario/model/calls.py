"""The calls of a scenario: the nine methods of the resource API under their own names, and halt."""

from __future__ import annotations

from typing import Any, Final

from pydantic import PositiveInt

from eal_actors.kernel.strict_model import StrictModel
from eal_actors.scenario.expressions import Known, render, render_text
from eal_actors.scenario.model.base import TimedStep
from eal_actors.scenario.model.values import Text, Value, VariableName

TEXT_FIELDS: Final = ("cmd", "req", "key")
"""What a method takes as text, even if it reads like a number."""


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


class CallStep(TimedStep):
    """A call of one robot's resource; the step is over when it is answered."""

    @property
    def arguments(self) -> ResourceArguments:
        """What the call is given."""
        found: ResourceArguments = getattr(self, self.kind)
        return found

    @property
    def is_together(self) -> bool:
        """Whether all robots of the `on` begin it at the same time."""
        return False


class StartStep(CallStep):
    """A call that can begin at an agreed time."""

    together: bool = False
    """All robots of the `on` meet, and begin it at the same time."""

    @property
    def is_together(self) -> bool:
        """See CallStep."""
        return self.together


class AnswerStep(CallStep):
    """A call that is answered with a value."""

    save_as: VariableName | None = None
    """Variable that keeps the answer, for the later steps of the same role."""
    save: Text | None = None
    """File that keeps the answer, in the robot's folder of the run directory; its suffix tells how."""


class GetStatus(CallStep):
    """Ask for the status."""

    kind = "get_status"
    get_status: ResourceArguments


class GetValue(AnswerStep):
    """Ask for the value."""

    kind = "get_value"
    get_value: ResourceArguments


class SetValue(StartStep):
    """Set the value."""

    kind = "set_value"
    set_value: ValueArguments


class SendReq(AnswerStep):
    """Send a request."""

    kind = "send_req"
    send_req: RequestArguments


class SendCmd(StartStep):
    """Send a command; the step is over when the command is."""

    kind = "send_cmd"
    send_cmd: CommandArguments


class ReadComm(AnswerStep):
    """Read bytes."""

    kind = "read_comm"
    read_comm: ReadArguments


class WriteComm(CallStep):
    """Write bytes."""

    kind = "write_comm"
    write_comm: WriteArguments


class GetConfig(AnswerStep):
    """Ask for a configuration value."""

    kind = "get_config"
    get_config: KeyArguments


class SetConfig(CallStep):
    """Set a configuration value."""

    kind = "set_config"
    set_config: ConfigArguments


class Halt(CallStep):
    """Stop what moves, at once."""

    kind = "halt"
    halt: ResourceArguments


CALLS: Final[tuple[type[CallStep], ...]] = (
    GetStatus,
    GetValue,
    SetValue,
    SendReq,
    SendCmd,
    ReadComm,
    WriteComm,
    GetConfig,
    SetConfig,
    Halt,
)


def call_fields(step: CallStep) -> dict[str, Any]:
    """Return what a call gives its method beside the resource, by the API's names and in its order."""
    arguments = step.arguments
    return {name: getattr(arguments, name) for name in type(arguments).model_fields if name != "resource"}


def resolved_fields(step: CallStep, known: Known) -> dict[str, Any]:
    """Return the same with expressions worked out.

    Raises:
        ScenarioError: see `render`.
    """
    return {
        name: render_text(value, known) if name in TEXT_FIELDS else render(value, known)
        for name, value in call_fields(step).items()
    }
