"""What a resource says of itself: its types, methods, commands, requests and configuration keys.

Tools list it, and a scenario is checked against it before anything moves. Everything here is immutable and plain.
"""

from __future__ import annotations

import enum
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final, Protocol, TypeVar

from eal_actors.device.data import DataType, EALData
from eal_actors.kernel.errors import ArgumentError
from eal_actors.kernel.strict_model import did_you_mean


class ResourceType(enum.Flag):
    """The four broad types; a resource is one or several of them (Source: thesis table 4.1)."""

    SENSOR = enum.auto()
    """Gets an input."""
    ACTUATOR = enum.auto()
    """Manipulates something."""
    COMMUNICATION = enum.auto()
    """Carries general data both ways."""
    OTHER = enum.auto()
    """Fits no other type."""

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the types it combines, in the order of the table."""
        return tuple(member.name for member in type(self) if member in self and member.name)


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

_NUMERIC: Final = (DataType.INT, DataType.FLOAT, DataType.DOUBLE)


@dataclass(frozen=True, slots=True)
class ValueInfo:
    """The type, unit and range of a value.

    Attributes:
        type: the data type; an integer is welcome where FLOAT or DOUBLE is wanted.
        unit: the unit's symbol, such as `m`, `deg` or `rad/s`; None for a bare number or text.
        minimum: the least value allowed, itself included, in the unit; None for no limit.
        maximum: the greatest value allowed, itself included, in the unit; None for no limit.
        choices: the values allowed, where they are few; empty for no such limit.
        shape: the array's shape, where None stands for any size; () for a single value.
        description: one line for people.
    """

    type: DataType
    unit: str | None = None
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str | float, ...] = ()
    shape: tuple[int | None, ...] = ()
    description: str = ""

    def check(self, data: EALData, what: str) -> None:
        """Raise ArgumentError, naming `what`, unless the value has the type, shape and range."""
        if problem := self.problem(data):
            raise ArgumentError(f"{what} {problem}")

    def problem(self, data: EALData) -> str | None:
        """Return what is wrong with the value, to be read after its name, or None."""
        numeric = self.type in _NUMERIC and data.type in _NUMERIC
        whole = self.type is DataType.INT and data.type is not DataType.INT
        if (data.type is not self.type and not numeric) or whole:
            return f"must be {self.describe()}, not {_shown(data)}"
        if self.shape:
            return self._shape_problem(data)
        value = data.value
        if self.choices and value not in self.choices:
            return f"must be one of {', '.join(map(str, self.choices))}, not {value!r}"
        if self.type in _NUMERIC:
            if not isinstance(value, int | float):
                return f"must be {self.describe()}, not {_shown(data)}"
            below = self.minimum is not None and not value >= self.minimum
            above = self.maximum is not None and not value <= self.maximum
            if below or above or value != value:  # the last: not a number
                return f"must be {self.describe()}, not {value:g}"
        return None

    def _shape_problem(self, data: EALData) -> str | None:
        shape = data.shape
        if shape is None:
            value = data.value
            shape = (len(value),) if isinstance(value, list | tuple) else ()
        fits = len(shape) == len(self.shape) and all(
            want is None or want == have for want, have in zip(self.shape, shape, strict=True)
        )
        return None if fits else f"must be {self.describe()}, not of shape {shape}"

    def describe(self) -> str:
        """Return the type, range and unit as people write them, such as `double 0..360 deg`."""
        parts = [self.type.name.lower()]
        if self.shape:
            parts.append("(" + ", ".join("n" if size is None else str(size) for size in self.shape) + ")")
        if self.minimum is not None or self.maximum is not None:
            low = "" if self.minimum is None else f"{self.minimum:g}"
            high = "" if self.maximum is None else f"{self.maximum:g}"
            parts.append(f"{low}..{high}")
        if self.choices:
            parts.append("|".join(map(str, self.choices)))
        if self.unit:
            parts.append(self.unit)
        return " ".join(parts)


def _shown(data: EALData) -> str:
    """Return a value as its user wrote it, where it is short."""
    value = data.value if data.shape is None else data
    return repr(value if isinstance(value, int | float | str | None) else data)


_PLACEHOLDER: Final = re.compile(r"<(\w+)>$")


@dataclass(frozen=True, slots=True)
class CommandInfo:
    """One command or request.

    Attributes:
        name: as it is written, such as `s`; a name such as `r<degrees>` carries its argument in the text: `r45`.
        argument: what it takes, in the text where the name says so, else as the call's data; None for nothing.
        returns: what a request answers; None for a command.
        urgent: it overtakes what waits in the mailbox, and drops the motions that wait there. For stops.
        description: one line for people.
    """

    name: str
    argument: ValueInfo | None = None
    returns: ValueInfo | None = None
    urgent: bool = False
    description: str = ""

    @property
    def prefix(self) -> str | None:
        """The text before an argument that is carried in the name, or None."""
        match = _PLACEHOLDER.search(self.name)
        return self.name[: match.start()] if match else None

    def describe(self) -> str:
        """Return name and argument as people write them."""
        return f"{self.name} ({self.argument.describe()})" if self.argument else self.name


@dataclass(frozen=True, slots=True)
class ConfigInfo:
    """One configuration key.

    Attributes:
        name: the key.
        value: its type, unit and range.
        writable: whether set_config takes it.
        description: one line for people.
    """

    name: str
    value: ValueInfo
    writable: bool = True
    description: str = ""


class _Named(Protocol):
    @property
    def name(self) -> str: ...


_N = TypeVar("_N", bound=_Named)


def unknown_name(kind: str, name: str, known: Iterable[str]) -> str:
    """Return the message for a name that is none of the known ones, with the nearest as a hint."""
    return f"unknown {kind} {name!r}{did_you_mean(name, known)}"


@dataclass(frozen=True)
class ResourceInfo:
    """All that a resource says of itself (Source: thesis §4.2.1, EALResourceInfo_t).

    Attributes:
        name: the resource's name on its robot.
        types: the types it combines.
        methods: which of METHODS it supports.
        value: what get_value answers and set_value takes, where the author said so.
        commands: what send_cmd takes; empty with send_cmd supported means free text.
        requests: what send_req takes; likewise.
        configs: what get_config and set_config take; likewise.
        description: one line for people.
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

    def __post_init__(self) -> None:
        object.__setattr__(self, "urgent_commands", frozenset(c.name for c in self.commands if c.urgent))

    @property
    def is_camera(self) -> bool:
        """Whether it is a sensor whose values are RGB images."""
        value = self.value
        is_image = value is not None and value.type is DataType.CHAR and len(value.shape) == 3 and value.shape[2] == 3
        return is_image and ResourceType.SENSOR in self.types

    def parse_command(self, text: str, data: EALData | None) -> tuple[CommandInfo, EALData | None]:
        """Find the command a text means, and its checked argument.

        Args:
            text: what send_cmd was given, such as `s` or `r45`.
            data: what send_cmd was given as data.

        Returns:
            The command and its argument, None where it takes none.

        Raises:
            ArgumentError: no such command, or an argument missing, unwanted, of the wrong type or out of range.
        """
        return _parse("command", self.commands, text, data)

    def parse_request(self, text: str) -> tuple[CommandInfo, EALData | None]:
        """Find the request a text means, and its checked argument; see parse_command."""
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
        del fields["urgent_commands"]
        fields["types"] = list(self.types.names)
        fields["methods"] = [method for method in METHODS if method in self.methods]
        return _plain(fields)  # type: ignore[no-any-return]  # a dict goes in, so a dict comes out

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any]) -> ResourceInfo:
        """Rebuild what to_dict made."""
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
                    raise ArgumentError(f"{kind} {text!r} takes no argument, but was given {_shown(data)}")
                return info, None
            if data is None:
                raise ArgumentError(f"{kind} {text!r} needs an argument: {info.argument.describe()}")
            info.argument.check(data, f"{kind} {text!r}: its argument")
            return info, data
    for info in known:
        prefix = info.prefix
        if prefix is None or not text.startswith(prefix) or info.argument is None:
            continue
        argument = _parse_number(text[len(prefix) :], info.argument)
        if argument is not None:
            info.argument.check(argument, f"{kind} {text!r}: its argument")
            if data is not None:
                raise ArgumentError(
                    f"{kind} {text!r} carries its argument in the text, but was given {_shown(data)} too"
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
    return ValueInfo(
        **{
            **fields,
            "type": DataType[fields["type"]],
            "choices": tuple(fields["choices"]),
            "shape": tuple(fields["shape"]),
        }
    )


def _command_info(fields: Mapping[str, Any]) -> CommandInfo:
    return CommandInfo(
        **{**fields, "argument": _value_info(fields["argument"]), "returns": _value_info(fields["returns"])}
    )


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value.name if isinstance(value, DataType) else value
