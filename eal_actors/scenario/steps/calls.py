"""The calls: the nine methods of the resource API under their own names, and `halt`.

They are one kind with ten methods. Each adds only the model of its arguments.
"""

from __future__ import annotations

from pydantic import PositiveInt

from eal_actors.scenario.language.values import Text, Value
from eal_actors.scenario.steps.call import AnswerStep, CallStep, ResourceArguments, StartStep


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
    """Bytes to write; defaults to all."""


class KeyArguments(ResourceArguments):
    """For get_config."""

    key: Text


class ConfigArguments(KeyArguments):
    """For set_config."""

    value: Value | None = None


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
