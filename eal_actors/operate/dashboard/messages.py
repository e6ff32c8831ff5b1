"""What a browser may say: one JSON object with `do`, strictly as one of these models."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from eal_actors.kernel.errors import ArgumentError
from eal_actors.kernel.strict_model import StrictModel
from eal_actors.operate.dashboard.limits import MAX_CAMERAS, MAX_FRAMES_PER_S, MAX_MESSAGE_BYTES

Word = Annotated[str, Field(max_length=200)]
Text = Annotated[str, Field(max_length=MAX_MESSAGE_BYTES)]
Number = Annotated[int, Field(ge=0, le=2**53)]
CallMethod = Literal["get_status", "get_value", "set_value", "send_req", "send_cmd", "get_config", "set_config", "halt"]
"""All methods but those that carry bytes, and `halt`."""
Scalar = bool | int | float | Text
CallValue = Scalar | Annotated[tuple[bool | int | float, ...], Field(strict=False, max_length=1000)] | None


class Hello(StrictModel):
    """The first message."""

    do: Literal["hello"]
    token: Word | None = None


class Watch(StrictModel):
    """Which cameras to show from now on, in place of those before."""

    do: Literal["watch"]
    cameras: Annotated[tuple[tuple[Word, Word], ...], Field(strict=False, max_length=MAX_CAMERAS)] = ()
    """Robots and their resources."""
    rate_hz: float = Field(default=5.0, gt=0, le=MAX_FRAMES_PER_S)
    """Frames in a real second."""


class Describe(StrictModel):
    """Tell what a robot's resources offer."""

    do: Literal["describe"]
    id: Number
    robot: Word


class ListScenarios(StrictModel):
    """Tell which scenarios there are, and their parameters."""

    do: Literal["scenarios"]
    id: Number


class CallResource(StrictModel):
    """Call a method of a resource."""

    do: Literal["call"]
    id: Number
    robot: Word
    resource: Word
    method: CallMethod
    text: Word | None = None
    """The command, request or key."""
    value: CallValue = None


class Stop(StrictModel):
    """Emergency stop of every robot."""

    do: Literal["stop"]
    id: Number


class Resume(StrictModel):
    """End the emergency stop."""

    do: Literal["resume"]
    id: Number


class Drive(StrictModel):
    """Go on driving: said again and again while a key is held."""

    do: Literal["drive"]
    robot: Word
    grip: Number
    """Number of the time that the keys are held, higher than all before of this page."""
    speed_m_s: float = Field(ge=-10, le=10)
    turn_rad_s: float = Field(ge=-20, le=20)


class LetGo(StrictModel):
    """Drive no more."""

    do: Literal["let_go"]
    robot: Word


class StartRun(StrictModel):
    """Carry out a scenario."""

    do: Literal["start"]
    id: Number
    file: Word
    parameters: dict[Word, Scalar | Annotated[tuple[Scalar, ...], Field(strict=False)]] = Field(default={})


class ControlRun(StrictModel):
    """Control the run."""

    do: Literal["control"]
    id: Number
    what: Literal["pause", "resume", "step", "abort"]


Message = Annotated[
    Hello | Watch | Describe | ListScenarios | CallResource | Stop | Resume | Drive | LetGo | StartRun | ControlRun,
    Field(discriminator="do"),
]

COMMANDS = (CallResource, Stop, Resume, Drive, LetGo, StartRun, ControlRun)
"""What only those may say who may command."""

_ADAPTER: TypeAdapter[Any] = TypeAdapter(Message)


def parse_message(text: str) -> Any:
    """Return the message that a browser's text means.

    Raises:
        ArgumentError: it means none, and what is wrong with it.
    """
    try:
        return _ADAPTER.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ArgumentError(f"this message makes no sense: {place}: {first['msg']}") from None
