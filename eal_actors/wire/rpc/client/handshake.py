"""Decoding of a robot's handshake (`hello`), pings and running commands, field by field: another machine sends them.

Either all of an answer is valid, or ProtocolError: a robot is never half known. Fields and methods that this release
does not know are ignored, and fields that older robots do not send have defaults: releases of one protocol version mix.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from eal_actors.actors.robot_view import MailboxLoad, Ping, RobotState, RunningCommand
from eal_actors.device.info import METHODS, ResourceInfo
from eal_actors.device.resource import Progress
from eal_actors.kernel.errors import EALError, ProtocolError, error_text
from eal_actors.wire.format.messages import Answer, CallId
from eal_actors.wire.security.access import Rights

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Handshake:
    """A robot's answer to the handshake.

    Attributes:
        stopped: reason of its emergency stop; None if it is not stopped.
        problems: errors of its plugins.
        left_out: reasons why connected plugins lack resources.
        not_ready: reasons why resources are not ready, by name.
        rights: calls that it grants; None for all.
        running: rows of running commands; see running_from.
        process: the process that serves it, if that takes batches; else empty.
        has_failed: whether it is served only to report the reason, the last one of `problems`.
    """

    infos: tuple[ResourceInfo, ...]
    stopped: str | None
    problems: tuple[str, ...]
    left_out: tuple[str, ...]
    not_ready: Mapping[str, str]
    rights: Rights | None
    running: object
    process: str
    has_failed: bool

    @classmethod
    def decode(cls, answer: Answer, certificate: str | None) -> Self:
        """Decode an answer.

        Raises ProtocolError if the answer is malformed, or the robot refuses; the message continues the robot's name.
        """
        if not isinstance(answer, dict):
            reason = answer.message if isinstance(answer, EALError) else f"answered {answer!r}"
            raise ProtocolError(f"refuses the connection: {reason}")
        try:
            stopped = answer["stopped"]
            return cls(
                tuple(info_from(fields) for fields in answer["resources"]),
                None if stopped is None else str(stopped),
                tuple(str(problem) for problem in answer["problems"]),
                tuple(str(reason) for reason in answer.get("left_out", ())),
                {str(name): str(reason) for name, reason in answer.get("not_ready", {}).items()},
                None if certificate is None else Rights.decode(answer.get("rights"), certificate),
                answer.get("running", ()),
                str(answer.get("process", "")),
                answer.get("state") == RobotState.FAILED.value,
            )
        except (ProtocolError, AttributeError, KeyError, TypeError) as error:
            raise ProtocolError(f"has sent a malformed handshake: {error_text(error)}") from error


class _Fields(BaseModel):
    """Fields by name, without conversions; unknown fields are ignored."""

    model_config = ConfigDict(strict=True, extra="ignore")


class _ValueFields(_Fields):
    type: str
    unit: str | None
    minimum: int | float | None
    maximum: int | float | None
    choices: list[str | bool | int | float]
    shape: list[int | None]
    description: str


_Seconds = Annotated[float, Field(ge=0.0, le=3600.0, allow_inf_nan=False)]


class _CommandFields(_Fields):
    name: str
    argument: _ValueFields | None
    returns: _ValueFields | None
    urgent: bool
    description: str
    seconds_per_unit: _Seconds = 0.0
    takes_s: _Seconds = 0.0
    pace: str = ""
    repeatable: bool = False


class _ConfigFields(_Fields):
    name: str
    value: _ValueFields
    writable: bool
    description: str


class _InfoFields(_Fields):
    name: str = Field(min_length=1)
    types: list[str]
    methods: list[str]
    value: _ValueFields | None
    commands: list[_CommandFields]
    requests: list[_CommandFields]
    configs: list[_ConfigFields]
    description: str


_INFO: Final = TypeAdapter(_InfoFields)
_PING: Final = TypeAdapter(Ping)
_LOADS: Final = TypeAdapter(dict[str, tuple[int, float]])
_COMMANDS: Final = TypeAdapter(list[tuple[str, int, int, dict[str, Any]]])
_COMMAND: Final = TypeAdapter(RunningCommand)
_PROGRESS: Final = TypeAdapter(tuple[float | None, str, float] | None)


def info_from(fields: object) -> ResourceInfo:
    """Rebuild the result of `ResourceInfo.to_dict` without unknown methods; ProtocolError if a field is malformed."""
    checked = _checked(_INFO, fields, "information of a resource")
    checked.methods = [method for method in checked.methods if method in METHODS]
    try:
        return ResourceInfo.from_dict(checked.model_dump())
    except KeyError as error:
        raise ProtocolError(f"information of a resource: there is no type {error}") from error


def ping_from(fields: Mapping[str, object]) -> Ping:
    """Return a ping from its fields; ProtocolError if one is malformed."""
    what = "the answer to a ping"
    loads = _checked(_LOADS, fields.get("mailboxes", {}), f"{what}: mailboxes")
    mailboxes = {name: MailboxLoad(*load) for name, load in loads.items()}
    return _checked(_PING, {**fields, "mailboxes": mailboxes}, what)


def running_from(rows: object) -> dict[CallId, RunningCommand]:
    """Return running commands from rows of client, epoch, sequence and fields; ProtocolError if one is malformed."""
    what, running = "a running command", {}
    for client, epoch, sequence, fields in _checked(_COMMANDS, rows, what):
        progress = _checked(_PROGRESS, fields.get("progress"), f"{what}: progress")
        fields["progress"] = progress and Progress(*progress)
        running[CallId(client, epoch, sequence)] = _checked(_COMMAND, fields, what)
    return running


def _checked(adapter: TypeAdapter[T], fields: object, what: str) -> T:
    try:
        return adapter.validate_python(fields)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"])) or "all of it"
        raise ProtocolError(f"{what}: {place}: {first['msg']}") from error
