"""The messages of VDA 5050 2.1 that both sides read and write; pure functions.

Unknown fields are ignored, as the standard demands of its minor versions. Numbers must be finite.

Source: VDA 5050 2.1.0, sections 6.3 to 6.15, and its published JSON schemas.
"""

from __future__ import annotations

import time
from collections import Counter
from datetime import UTC, datetime
from typing import Annotated, Any, Final, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel

from eal_actors.plugin import DataError

VERSION: Final = "2.1.0"
_MAJOR: Final = VERSION.partition(".")[0]
_MOST_PROBLEM: Final = 200
_MOST_WORDS: Final = 500
_MOST_NAME: Final = 1000
Name = Annotated[str, Field(max_length=_MOST_NAME)]
"""An identifier: states and errors repeat it."""


Metres = Annotated[float, Field(ge=-1e6, le=1e6)]
"""A coordinate: nothing is over 1,000 km from its map's origin."""
Words = Annotated[str, AfterValidator(lambda text: text[:_MOST_WORDS])]
"""Text for people; the rest of a long one is left out."""


class Part(BaseModel):
    """A part of a message: names are camelCase on the wire."""

    model_config = ConfigDict(
        alias_generator=to_camel, populate_by_name=True, extra="ignore", strict=True, allow_inf_nan=False
    )

    def wire(self) -> dict[str, Any]:
        """Return the fields as they are sent; what is not set is left out."""
        return self.model_dump(mode="json", by_alias=True, exclude_none=True)


class AgvHeader(Part):
    """The header of every message."""

    header_id: int
    timestamp: str
    version: str
    manufacturer: str
    serial_number: str


class ActionParameter(Part):
    """A parameter of an action."""

    key: str
    value: Any = None


class AgvAction(Part):
    """An action of a node, of an edge, or an instant one."""

    action_type: Name
    action_id: Name
    action_description: Words | None = None
    blocking_type: Literal["NONE", "SOFT", "HARD"]
    action_parameters: list[ActionParameter] | None = None

    def parameters(self) -> dict[str, Any]:
        """Return the parameters by their keys."""
        return {one.key: one.value for one in self.action_parameters or []}


class NodePosition(Part):
    """A place on a map, in m and rad."""

    x: Metres
    y: Metres
    theta: float | None = None
    allowed_deviation_xy: float | None = Field(default=None, alias="allowedDeviationXY")
    allowed_deviation_theta: float | None = None
    map_id: Name


class Node(Part):
    """A node of an order."""

    node_id: Name
    sequence_id: int
    released: bool
    node_position: NodePosition | None = None
    actions: list[AgvAction]


class Edge(Part):
    """An edge of an order."""

    edge_id: Name
    sequence_id: int
    released: bool
    start_node_id: Name
    end_node_id: Name
    max_speed: float | None = None
    max_rotation_speed: float | None = None
    orientation: float | None = None
    orientation_type: str | None = None
    rotation_allowed: bool | None = None
    actions: list[AgvAction]


class Order(AgvHeader):
    """An order, or an update of it."""

    order_id: Name = Field(min_length=1)
    order_update_id: int
    nodes: list[Node]
    edges: list[Edge]


class InstantActions(AgvHeader):
    """Actions that are carried out at once."""

    actions: list[AgvAction]


class Connection(AgvHeader):
    """Whether an AGV is connected: its own message, or its last will."""

    connection_state: Literal["ONLINE", "OFFLINE", "CONNECTIONBROKEN"]


class AgvPosition(Part):
    """The AGV's pose on a map, in m and rad."""

    x: Metres
    y: Metres
    theta: float
    map_id: Name
    position_initialized: bool
    localization_score: float | None = None
    deviation_range: float | None = None


class Velocity(Part):
    """The AGV's velocity, in m/s and rad/s."""

    vx: float | None = None
    vy: float | None = None
    omega: float | None = None


class NodeState(Part):
    """A node that is still to be passed."""

    node_id: Name
    sequence_id: int
    released: bool
    node_position: NodePosition | None = None


class EdgeState(Part):
    """An edge that is still to be left."""

    edge_id: Name
    sequence_id: int
    released: bool


class ActionState(Part):
    """The state of an action."""

    action_id: Name
    action_type: Name | None = None
    action_status: Literal["WAITING", "INITIALIZING", "RUNNING", "PAUSED", "FINISHED", "FAILED"]
    result_description: Words | None = None


class Reference(Part):
    """The subject of an error."""

    reference_key: Name
    reference_value: Name


class AgvError(Part):
    """An error that an AGV reports."""

    error_type: Name
    error_level: Literal["WARNING", "FATAL"]
    error_description: Words | None = None
    error_hint: Words | None = None
    error_references: list[Reference] | None = None

    def is_about(self, order_id: str) -> bool:
        """Return whether it refers to an order."""
        return any(one.reference_value == order_id for one in self.error_references or [])

    def text(self) -> str:
        """Return it for people."""
        return f"{self.error_type} ({self.error_level})" + (
            f": {self.error_description}" if self.error_description else ""
        )


class BatteryState(Part):
    """The battery; the charge is in percent."""

    battery_charge: float
    battery_voltage: float | None = None
    battery_health: float | None = None
    charging: bool
    reach: float | None = None


class SafetyState(Part):
    """The emergency stop and the protective field."""

    e_stop: Literal["AUTOACK", "MANUAL", "REMOTE", "NONE"]
    field_violation: bool


class AgvState(AgvHeader):
    """The state of an AGV."""

    order_id: Name
    order_update_id: int
    last_node_id: Name
    last_node_sequence_id: int
    driving: bool
    paused: bool | None = None
    new_base_request: bool | None = None
    operating_mode: Literal["AUTOMATIC", "SEMIAUTOMATIC", "MANUAL", "SERVICE", "TEACHIN"]
    node_states: list[NodeState]
    edge_states: list[EdgeState]
    agv_position: AgvPosition | None = None
    velocity: Velocity | None = None
    action_states: list[ActionState]
    battery_state: BatteryState
    errors: list[AgvError]
    safety_state: SafetyState

    @property
    def is_active(self) -> bool:
        """Whether it has an order to drive, or drives."""
        return self.driving or bool(self.node_states or self.edge_states)

    def action(self, action_id: str) -> ActionState | None:
        """Return the state of an action; None if it does not know it."""
        return next((one for one in self.action_states if one.action_id == action_id), None)


class Visualization(AgvHeader):
    """The pose of an AGV, more often than its state."""

    agv_position: AgvPosition | None = None
    velocity: Velocity | None = None


def _name(kind: type[Part]) -> str:
    """Return the standard's name of a message."""
    return kind.__name__.removeprefix("Agv").lower()


_M = TypeVar("_M", bound=AgvHeader)


def decode(kind: type[_M], payload: bytes) -> _M:
    """Return a message.

    Raises:
        DataError: it is no message of the kind, or of another major version.
    """
    try:
        message = kind.model_validate_json(payload)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        problem = f"{where}: {first['msg']}" if where else first["msg"]
        raise DataError(f"a message is no {_name(kind)} of VDA 5050: {problem[:_MOST_PROBLEM]}") from None
    if message.version.partition(".")[0] != _MAJOR:
        raise DataError(f"the other side speaks VDA 5050 {message.version[:20]}; this side speaks {VERSION}")
    return message


class Headers:
    """Makes the headers of one AGV's messages; each topic counts its own. Thread: one at a time."""

    def __init__(self, manufacturer: str, serial_number: str) -> None:
        self._identity = {"version": VERSION, "manufacturer": manufacturer, "serial_number": serial_number}
        self._counts = Counter[str]()

    def next(self, topic: str) -> dict[str, Any]:
        """Return the fields of the next header of a topic."""
        self._counts[topic] += 1
        return {"header_id": self._counts[topic], "timestamp": timestamp(time.time_ns() / 1e9), **self._identity}


def encode(message: Part) -> bytes:
    """Return a message as it is sent."""
    return message.model_dump_json(by_alias=True, exclude_none=True).encode()


def timestamp(unix_s: float) -> str:
    """Return a time as the standard writes it: UTC, with milliseconds."""
    return datetime.fromtimestamp(unix_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
