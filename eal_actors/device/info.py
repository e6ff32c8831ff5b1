"""The information of a resource about itself: its types, methods, commands, requests and configuration keys.

Tools list it, and a scenario is checked against it before anything moves. Everything here is immutable.
"""

from __future__ import annotations

import enum
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final

from eal_actors.device.data import DataType, EALData
from eal_actors.device.data.c_types import NUMERIC_TYPES, short_repr
from eal_actors.device.data.texts import range_text
from eal_actors.kernel.errors import ArgumentError
from eal_actors.kernel.suggestions import did_you_mean


class ResourceType(enum.Flag):
    """The four broad types; a resource has one or several of them (Source: thesis table 4.1)."""

    SENSOR = enum.auto()
    """Reads an input."""
    ACTUATOR = enum.auto()
    """Moves or changes something."""
    COMMUNICATION = enum.auto()
    """Transfers general data both ways."""
    OTHER = enum.auto()
    """Anything else."""

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the types it combines, in the order of the table."""
        return tuple(member.name for member in type(self) if member in self and member.name)


PATIENCE: Final = 2.0
"""A motion may take this many times as long as at its speed, before it is overdue."""

METHODS: Final = (
    "get_status",
    "get_value",
    "set_value",
    "send_req",
    "send_cmd",
    "read_comm",
    "write_comm",
    "get_config",
    "set_config",
)
"""The nine methods of the resource API (Source: thesis §4.2.1.1)."""


_PLACEHOLDER: Final = re.compile(r"<(\w+)>$")


@dataclass(frozen=True, slots=True)
class ValueInfo:
    """The type, unit and range of a value.

    Attributes:
        type: the data type; FLOAT and DOUBLE accept an integer too.
        unit: the unit's symbol, such as `m`, `deg` or `rad/s`; None for a bare number or text.
        minimum, maximum: the least and the greatest valid value, in the unit; None for no limit.
        choices: the valid values, if they are few; empty for no such limit.
        shape: the array's shape, with None for any size; () for a single value. A list fills rows.
    """

    type: DataType
    unit: str | None = None
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str | float, ...] = ()
    shape: tuple[int | None, ...] = ()
    description: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.type, DataType):
            raise ArgumentError(f"a ValueInfo's type must be a DataType, such as DataType.DOUBLE, not {self.type!r}")
        if not isinstance(self.shape, tuple):
            raise ArgumentError(f"a ValueInfo's shape must be a tuple, such as (3,), not {self.shape!r}")

    def check(self, data: EALData, what: str) -> None:
        """Raise ArgumentError, naming `what`, unless the value has the type, shape and range."""
        if problem := self.problem(data):
            raise ArgumentError(f"{what} {problem}")

    def problem(self, data: EALData) -> str | None:
        """Return the error of a value as the end of a sentence that begins with its name, or None."""
        kind, wanted = data.type, self.type
        if kind is not wanted and (wanted is DataType.INT or kind not in NUMERIC_TYPES or wanted not in NUMERIC_TYPES):
            return f"must be {self.describe()}, not {_repr_of(data)}"
        if self.shape:
            return self._shape_problem(data)
        value = data.value
        if self.choices and value not in self.choices:
            return f"must be one of {', '.join(map(str, self.choices))}, not {short_repr(value)}"
        return self._number_problem(data, value) if wanted in NUMERIC_TYPES else None

    def _number_problem(self, data: EALData, value: Any) -> str | None:
        if not isinstance(value, int | float):
            return f"must be {self.describe()}, not {_repr_of(data)}"
        below = self.minimum is not None and not value >= self.minimum
        above = self.maximum is not None and not value <= self.maximum
        return f"must be {self.describe()}, not {value:g}" if below or above or value != value else None  # NaN differs

    def _shape_problem(self, data: EALData) -> str | None:
        if (shape := data.shape) is None:
            shape = (len(value),) if isinstance(value := data.value, list | tuple) else ()
            match self.shape:  # a C array has no rows
                case (None, int() as row) if shape and shape[0] % row == 0:
                    shape = shape[0] // row, row
        if shape == self.shape:
            return None
        fits = len(shape) == len(self.shape) and all(
            want is None or want == have for want, have in zip(self.shape, shape, strict=True)
        )
        return None if fits else f"must be {self.describe()}, not of shape {shape}"

    def describe(self) -> str:
        """Return the type, range and unit as text, such as `double 0..360 deg`."""
        shape = "(" + ", ".join("n" if size is None else str(size) for size in self.shape) + ")" if self.shape else ""
        limits, choices = range_text(self.minimum, self.maximum), "|".join(map(str, self.choices))
        return " ".join(filter(None, (self.type.name.lower(), shape, limits, choices, self.unit)))


@dataclass(frozen=True, slots=True)
class CommandInfo:
    """One command or request.

    Attributes:
        name: its text, such as `s`; a name such as `r<degrees>` has its argument in the text: `r45`.
        argument: its argument, in the text if the name says so, else the call's data; None for none.
        returns: the answer of a request; None for a command.
        urgent: it overtakes all calls in the mailbox and drops the motions among them. For stops.
        seconds_per_unit: time that it takes for each unit of an argument in the text, added to the default deadline.
        takes_s: time that it may take whatever its argument, added likewise.
        pace: the configuration key of its speed, in units a second; empty for none.
        repeatable: given twice, it leads to the same state as once, so a resumed run may give it again.
    """

    name: str
    argument: ValueInfo | None = None
    returns: ValueInfo | None = None
    urgent: bool = False
    description: str = ""
    seconds_per_unit: float = 0.0
    takes_s: float = 0.0
    pace: str = ""
    repeatable: bool = False

    @property
    def prefix(self) -> str | None:
        """The text before an argument in the name, or None."""
        match = _PLACEHOLDER.search(self.name)
        return self.name[: match.start()] if match else None

    def describe(self) -> str:
        """Return name and argument as text."""
        return f"{self.name} ({self.argument.describe()})" if self.argument else self.name


@dataclass(frozen=True, slots=True)
class ConfigInfo:
    """One configuration key. `writable` is whether set_config accepts it."""

    name: str
    value: ValueInfo
    writable: bool = True
    description: str = ""

    def checked(self, data: EALData | None) -> EALData:
        """Return a value that set_config accepts, or raise ArgumentError."""
        if not self.writable:
            raise ArgumentError(f"configuration key {self.name!r} is read-only")
        if data is None:
            raise ArgumentError(f"configuration key {self.name!r} needs a value: {self.value.describe()}")
        self.value.check(data, f"configuration key {self.name!r}")
        return data


def unknown_name(kind: str, name: str, known: Iterable[str]) -> str:
    """Return the message for an unknown name, with the nearest known one as a hint."""
    if not isinstance(name, str):
        return f"unknown {kind} {name!r}: it must be a text"
    return f"unknown {kind} {short_repr(name)}{did_you_mean(name, known)}"


@dataclass(frozen=True)
class ResourceInfo:
    """The information of a resource about itself (Source: thesis §4.2.1, EALResourceInfo_t).

    Attributes:
        value: the value of get_value and set_value, if the author declared it.
        commands: the commands of send_cmd; empty with send_cmd supported means free text.
        requests: the requests of send_req; likewise.
        configs: the keys of get_config and set_config; likewise.
    """

    name: str
    types: ResourceType
    methods: frozenset[str]
    value: ValueInfo | None = None
    commands: tuple[CommandInfo, ...] = ()
    requests: tuple[CommandInfo, ...] = ()
    configs: tuple[ConfigInfo, ...] = ()
    description: str = ""
    urgent_commands: frozenset[str] = field(init=False)
    _timed_commands: tuple[tuple[str | None, CommandInfo], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.types, ResourceType):
            raise ArgumentError(f"{self.name}: types must be ResourceTypes, not {self.types!r}")
        calls = (*self.commands, *self.requests)
        for value in (self.value, *(call.argument for call in calls), *(call.returns for call in calls)):
            if not isinstance(value, ValueInfo | None):
                raise ArgumentError(f"{self.name}: {value!r} must be a ValueInfo")
        timed = (command for command in self.commands if command.seconds_per_unit or command.takes_s)
        object.__setattr__(self, "_timed_commands", tuple((command.prefix, command) for command in timed))
        object.__setattr__(self, "urgent_commands", frozenset(c.name for c in self.commands if c.urgent))

    @property
    def is_camera(self) -> bool:
        """Whether it is a sensor whose values are RGB images."""
        value = self.value
        is_image = value is not None and value.type is DataType.CHAR and len(value.shape) == 3 and value.shape[2] == 3
        return is_image and ResourceType.SENSOR in self.types

    def is_reading(self, req: str) -> bool:
        """Return whether a request moves nothing: it is declared, or the resource only senses.

        A request in free text may do anything, such as call a service of ROS 2 or an instant action of an AGV.
        """
        if self.types == ResourceType.SENSOR:
            return True
        try:
            self.parse_request(req)
        except ArgumentError:
            return False
        return True

    def parse_command(self, text: str, data: EALData | None) -> tuple[CommandInfo, EALData | None]:
        """Return the command of a text such as `s` or `r45`, and its checked argument, None if it takes none.

        Raises ArgumentError: no such command, or an argument missing, unwanted, of the wrong type or out of range.
        """
        return _parse("command", self.commands, text, data)

    def takes_s(self, command: str) -> float:
        """Return the time that a command takes, in seconds; 0 if that is not known."""
        if not isinstance(command, str):
            return 0.0  # parse_command refuses it
        for prefix, info in self._timed_commands:
            if command == info.name:
                return info.takes_s
            if prefix and command.startswith(prefix) and _NUMBER.match(number := command[len(prefix) :]):
                return info.takes_s + abs(float(number)) * info.seconds_per_unit
        return 0.0

    def at_pace(self, key: str, units_per_s: float) -> ResourceInfo:
        """Return the information after a configuration key, which may be the pace of commands, was set."""
        if units_per_s <= 0 or not any(command.pace == key for command in self.commands):
            return self
        seconds = {key: PATIENCE / units_per_s}
        commands = (
            replace(command, seconds_per_unit=seconds.get(command.pace, command.seconds_per_unit))
            for command in self.commands
        )
        return replace(self, commands=tuple(commands))

    def parse_request(self, text: str) -> tuple[CommandInfo, EALData | None]:
        """Return the request of a text, and its checked argument; see parse_command."""
        return _parse("request", self.requests, text, None)

    def config(self, key: str) -> ConfigInfo:
        """Return a configuration key's information, or raise ArgumentError."""
        for config in self.configs:
            if config.name == key:
                return config
        raise ArgumentError(unknown_name("configuration key", key, (c.name for c in self.configs)))

    def to_dict(self) -> dict[str, Any]:
        """Return plain dicts, lists, strings and numbers, for JSON and the network."""
        fields = asdict(self)
        del fields["urgent_commands"], fields["_timed_commands"]
        fields["types"] = list(self.types.names)
        fields["methods"] = [method for method in METHODS if method in self.methods]
        return _to_plain(fields)  # type: ignore[no-any-return]  # a dict goes in, so a dict comes out

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any]) -> ResourceInfo:
        """Rebuild the information from the result of to_dict."""
        types = ResourceType(0)
        for name in fields["types"]:
            types |= ResourceType[name]
        return cls(
            name=fields["name"],
            types=types,
            methods=frozenset(fields["methods"]),
            value=_value_info(fields["value"]),
            commands=tuple(_command_info(c) for c in fields["commands"]),
            requests=tuple(_command_info(c) for c in fields["requests"]),
            configs=tuple(
                ConfigInfo(**{**c, "value": _value_info(c["value"])})  # the key's type is checked by _value_info
                for c in fields["configs"]
            ),
            description=fields["description"],
        )


def _parse(
    kind: str, known: tuple[CommandInfo, ...], text: str, data: EALData | None
) -> tuple[CommandInfo, EALData | None]:
    for info in known:
        if info.name == text:
            if info.argument is None:
                if data is not None:
                    raise ArgumentError(f"{kind} {text!r} takes no argument, but was given {_repr_of(data)}")
                return info, None
            if data is None:
                raise ArgumentError(f"{kind} {text!r} needs an argument: {info.argument.describe()}")
            info.argument.check(data, f"{kind} {text!r}: its argument")
            return info, data
    for info in known:
        prefix = info.prefix
        if prefix is None or not str(text).startswith(prefix) or info.argument is None:
            continue
        if (argument := _parse_number(text[len(prefix) :], info.argument)) is not None:
            info.argument.check(argument, f"{kind} {text!r}: its argument")
            if data is not None:
                raise ArgumentError(
                    f"{kind} {text!r} carries its argument in the text, but was given {_repr_of(data)} too"
                )
            return info, argument
    raise ArgumentError(unknown_name(kind, text, (c.name for c in known)))


_NUMBER: Final = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)$")


def _parse_number(text: str, info: ValueInfo) -> EALData | None:
    if info.type is DataType.CHAR:
        return EALData.of(text) if text else None
    if not _NUMBER.match(text):
        return None
    if info.type is DataType.INT:
        return EALData.of(int(text)) if text.lstrip("+-").isdecimal() else None
    return EALData.of(float(text))


def _value_info(fields: Mapping[str, Any] | None) -> ValueInfo | None:
    if fields is None:
        return None
    choices, shape = tuple(fields["choices"]), tuple(fields["shape"])
    return ValueInfo(**{**fields, "type": DataType[fields["type"]], "choices": choices, "shape": shape})


def _command_info(fields: Mapping[str, Any]) -> CommandInfo:
    return CommandInfo(
        **{**fields, "argument": _value_info(fields["argument"]), "returns": _value_info(fields["returns"])}
    )


def _to_plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_to_plain(item) for item in value]
    return value.name if isinstance(value, DataType) else value


def _repr_of(data: EALData) -> str:
    """Return a value as its user wrote it, if that is short."""
    value = data.value if data.shape is None else data
    return short_repr(value) if isinstance(value, int | float | str | None) else repr(data)
