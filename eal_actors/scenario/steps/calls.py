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


class GetStatus(CallStep, kind="get_status"):
    """Ask for the status."""

    get_status: ResourceArguments


class GetValue(AnswerStep, kind="get_value"):
    """Ask for the value."""

    get_value: ResourceArguments


class SetValue(StartStep, kind="set_value"):
    """Set the value."""

    set_value: ValueArguments


class SendReq(AnswerStep, kind="send_req"):
    """Send a request."""

    send_req: RequestArguments


class SendCmd(StartStep, kind="send_cmd"):
    """Send a command; the step is over when the command is."""

    send_cmd: CommandArguments


class ReadComm(AnswerStep, kind="read_comm"):
    """Read bytes."""

    read_comm: ReadArguments


class WriteComm(CallStep, kind="write_comm"):
    """Write bytes."""

    write_comm: WriteArguments


class GetConfig(AnswerStep, kind="get_config"):
    """Ask for a configuration value."""

    get_config: KeyArguments


class SetConfig(CallStep, kind="set_config"):
    """Set a configuration value."""

    set_config: ConfigArguments


class Halt(CallStep, kind="halt"):
    """Stop what moves, at once."""

    halt: ResourceArguments
