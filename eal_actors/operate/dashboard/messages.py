"""Messages from browsers: JSON objects, told apart by their key `do`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import Field, TypeAdapter, ValidationError

from eal_actors.kernel.errors import ArgumentError
from eal_actors.kernel.strict_model import StrictModel
from eal_actors.operate.dashboard.access import Role
from eal_actors.operate.dashboard.limits import MAX_CAMERAS, MAX_FRAMES_PER_S, MAX_MESSAGE_BYTES

Word = Annotated[str, Field(max_length=200)]
Text = Annotated[str, Field(max_length=MAX_MESSAGE_BYTES)]
Number = Annotated[int, Field(ge=0, le=2**53)]
CallMethod = Literal["get_status", "get_value", "set_value", "send_req", "send_cmd", "get_config", "set_config", "halt"]
"""All methods but those that carry bytes, and `halt`."""
Scalar = bool | int | float | Text
Numbers = Annotated[tuple[bool | int | float, ...], Field(strict=False, max_length=1000)]
CallValue = Scalar | Numbers | Annotated[tuple[Numbers, ...], Field(strict=False, max_length=1000)] | None


class Hello(StrictModel):
    """The first message."""

    do: Literal["hello"]
    token: Word | None = None


class Watch(StrictModel):
    """Choose the cameras to show, in place of the previous ones."""

    do: Literal["watch"]
    cameras: Annotated[tuple[tuple[Word, Word], ...], Field(strict=False, max_length=MAX_CAMERAS)] = ()
    """Robots and their resources."""
    rate_hz: float = Field(default=5.0, gt=0, le=MAX_FRAMES_PER_S)
    """Frames per real second."""


class WatchValues(StrictModel):
    """Choose the robot whose live values to send, in place of the previous one."""

    do: Literal["watch_values"]
    robot: Word | None


class DriveRobot(StrictModel):
    """Drive at a twist; repeated while a key is held."""

    do: Literal["drive"]
    robot: Word
    press: Number
    """The number of this key press, higher than all before it of this page."""
    heard_s: float | None = None
    """As in `_AnsweredMessage`."""
    speed_m_s: float = Field(ge=-10, le=10)
    turn_rad_s: float = Field(ge=-20, le=20)


class ReleaseRobot(StrictModel):
    """End a key press: halt the robot."""

    do: Literal["release"]
    robot: Word


class _AnsweredMessage(StrictModel):
    """A message that is answered under its number."""

    id: Number
    heard_s: float | None = None
    """The time of the newest update that the page had received: by it, commands that were held up are refused."""


class Describe(_AnsweredMessage):
    """Describe a robot's resources."""

    do: Literal["describe"]
    robot: Word


class ListScenarios(_AnsweredMessage):
    """List the scenarios and their parameters."""

    do: Literal["scenarios"]


class CallResource(_AnsweredMessage):
    """Call a method of a resource."""

    do: Literal["call"]
    robot: Word
    resource: Word
    method: CallMethod
    text: Word | None = None
    """The command, request or key."""
    value: CallValue = None


class CommandRobots(_AnsweredMessage):
    """Send a command to several robots, or halt them: the text `halt` without a resource."""

    do: Literal["command"]
    robots: Annotated[tuple[Word, ...], Field(strict=False, min_length=1, max_length=1000)]
    resource: Word
    text: Word
    value: CallValue = None


FloorNumber = Annotated[float, Field(ge=-1e6, le=1e6)]
FloorCorner = Annotated[tuple[FloorNumber, FloorNumber], Field(strict=False)]
DrawnZone = Annotated[tuple[FloorCorner, ...], Field(strict=False, min_length=3, max_length=100)]


class SendRobot(_AnsweredMessage):
    """Send a robot to a point of the floor."""

    do: Literal["send"]
    robot: Word
    x_m: FloorNumber
    y_m: FloorNumber
    keep_out: Annotated[tuple[DrawnZone, ...], Field(strict=False, max_length=50)] = ()
    """Zones drawn on the page, which the path avoids."""


class StopAll(_AnsweredMessage):
    """Stop every robot: the emergency stop."""

    do: Literal["stop"]


class ResumeAll(_AnsweredMessage):
    """End the emergency stop."""

    do: Literal["resume"]


class ReloadFleet(_AnsweredMessage):
    """Read the fleet file again, and adopt its changes."""

    do: Literal["reload"]


class StartRun(_AnsweredMessage):
    """Run a scenario."""

    do: Literal["start"]
    file: Word
    parameters: dict[Word, Scalar | Annotated[tuple[Scalar, ...], Field(strict=False)]] = Field(default={})


class ListPlans(_AnsweredMessage):
    """List the plans of agents that wait for a decision."""

    do: Literal["plans"]


class DecidePlan(_AnsweredMessage):
    """Approve or refuse the plan of an agent."""

    do: Literal["decide"]
    hash: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    approve: bool


class ControlRun(_AnsweredMessage):
    """Control the run."""

    do: Literal["control"]
    what: Literal["pause", "resume", "step", "abort"]


Message = Annotated[
    Hello
    | Watch
    | WatchValues
    | DriveRobot
    | ReleaseRobot
    | Describe
    | ListScenarios
    | CallResource
    | CommandRobots
    | SendRobot
    | StopAll
    | ResumeAll
    | ReloadFleet
    | StartRun
    | ListPlans
    | DecidePlan
    | ControlRun,
    Field(discriminator="do"),
]

_ROLES: Final[Mapping[type, Role]] = {
    **dict.fromkeys((CallResource, CommandRobots, SendRobot, StopAll, ResumeAll, DriveRobot, ReleaseRobot), Role.DRIVE),
    **dict.fromkeys((StartRun, ControlRun, ListPlans, DecidePlan), Role.RUN),
    ReloadFleet: Role.ADMINISTER,
}


_COMMANDS: Final = (
    CallResource,
    CommandRobots,
    SendRobot,
    DriveRobot,
    ResumeAll,
    ReloadFleet,
    StartRun,
    DecidePlan,
    ControlRun,
)


def may_expire(message: object) -> bool:
    """Return whether a message may begin or change something, so that it must not be obeyed late."""
    match message:
        case CallResource(method="halt") | CommandRobots(resource="") | ControlRun(what="abort" | "pause"):
            return False
        case _:
            return isinstance(message, _COMMANDS)


def needed_role(message: object) -> Role:
    """Return the role that a message needs."""
    if isinstance(message, CallResource) and message.method == "set_config":
        return Role.ADMINISTER
    return _ROLES.get(type(message), Role.WATCH)


_ADAPTER: TypeAdapter[Any] = TypeAdapter(Message)


def parse_message(text: str) -> Any:
    """Return the message in a browser's text. Raises ArgumentError if the text is no valid message."""
    try:
        return _ADAPTER.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ArgumentError(f"invalid message: {place}: {first['msg']}") from None
