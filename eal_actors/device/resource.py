"""The Resource base class that plugin authors extend.

A quick sensor is a class with a `get_value`. Commands, requests and configuration keys are ordinary methods under
a decorator, which also provides the resource's information. A command that takes time is a generator, an *activity*:
it starts the motion, yields the seconds until its next step, and returns the result; its `finally` stops the motors.
One thread runs everything of one resource, so an author needs no locks.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Final, TypeAlias, TypeVar

from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import METHODS, CommandInfo, ConfigInfo, ResourceInfo, ResourceType, ValueInfo
from eal_actors.kernel.errors import ArgumentError, UnsupportedError

Activity: TypeAlias = Generator[float, None, Any]
"""Long work: yields seconds until its next step, returns the result, stops the motors in its `finally`."""


@dataclass(frozen=True, slots=True)
class Progress:
    """The progress of an activity.

    Attributes:
        fraction: the part that is done, 0..1; None if unknown.
        text: the present stage, for people; may be empty.
        time_s: the time of the report, by the fleet's clock.
    """

    fraction: float | None
    text: str
    time_s: float


_F = TypeVar("_F", bound=Callable[..., Any])
_MARK: Final = "_eal_mark"


def command(
    name: str,
    argument: ValueInfo | None = None,
    *,
    urgent: bool = False,
    repeatable: bool = False,
    takes_s: float = 0.0,
    description: str = "",
) -> Callable[[_F], _F]:
    """Make a method a command of send_cmd.

    The method gets the argument's Python value, if there is an argument, and returns a status int, None (which
    counts as 1, success), or a generator, see Activity. A newer command, a set_value or a halt closes a running one.

    Args:
        name: the command's text; `r<degrees>` takes the argument from the text, as in `r45`.
        argument: its type, unit and range.
        urgent: overtake all calls in the mailbox and drop the commands among them. For stops.
        repeatable: given twice, it leads to the same state as once, as a lamp that is switched on.
        takes_s: time that it may take, added to the default deadline of its calls; in seconds of the fleet's clock.
        description: one line for people; the method's docstring's first line if empty.
    """
    fields = {"argument": argument, "urgent": urgent, "repeatable": repeatable or urgent, "description": description}
    return _marker("command", name, **fields, takes_s=takes_s)


def request(
    name: str, returns: ValueInfo | None = None, argument: ValueInfo | None = None, *, description: str = ""
) -> Callable[[_F], _F]:
    """Make a method a request of send_req; like `command`, but it returns data and disturbs no running command."""
    return _marker("request", name, argument=argument, returns=returns, description=description)


def config(name: str, value: ValueInfo, *, description: str = "") -> Callable[[_F], _F]:
    """Make a method the getter of a configuration key; without a `config_setter` the key is read-only."""
    return _marker("config", name, value=value, description=description)


def config_setter(name: str) -> Callable[[_F], _F]:
    """Make a method the setter of a configuration key; it gets the checked Python value."""
    return _marker("config_setter", name)


def setting(value: ValueInfo, description: str) -> Any:
    """Declare an attribute that is a configuration key of the same name, which can be read and set.

        speed_m_s: float = setting(ValueInfo(DataType.DOUBLE, "m/s", 0, 0.5), "Speed of moving.")

    The resource gives it its first value in `__init__`. For a key with effects of its own, see `config`. `value` is its
    type, unit and range; `description` is one line for people.
    """
    return _Setting(value, description)


class _Setting:
    """The declaration of a setting. The resource's own attribute hides it, so that reading costs nothing more."""

    def __init__(self, value: ValueInfo, description: str) -> None:
        self.fields = {"value": value, "description": description}
        self._is_float = value.type is DataType.DOUBLE

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, resource: Resource | None, owner: type) -> _Setting:
        if resource is not None:
            raise AttributeError(f"{owner.__name__} gives its setting {self._name!r} no first value")
        return self

    def set(self, resource: Resource, value: Any) -> None:
        setattr(resource, self._name, float(value) if self._is_float else value)


def _marker(kind: str, name: str, **fields: Any) -> Callable[[_F], _F]:
    _check_declaration(kind, name, fields)

    def mark(method: _F) -> _F:
        if not fields.get("description"):
            fields["description"] = (method.__doc__ or "").strip().partition("\n")[0]
        setattr(method, _MARK, (kind, name, fields))
        return method

    return mark


def _check_declaration(kind: str, name: str, fields: dict[str, Any]) -> None:
    """Raise ArgumentError for a command or request whose declaration makes it impossible to call."""
    if kind not in ("command", "request"):
        return
    has_argument, carries_it = fields.get("argument") is not None, CommandInfo(name).prefix is not None
    if not carries_it and ("<" in name or ">" in name):
        raise ArgumentError(f"{kind} {name!r}: an argument in the text must be at its end, as in 'r<degrees>'")
    if carries_it and not has_argument:
        raise ArgumentError(f"{kind} {name!r} needs a ValueInfo for its argument")
    if kind == "request" and has_argument and not carries_it:
        raise ArgumentError(f"request {name!r} has nothing but its text to carry an argument, as in 'joint<number>'")
    if carries_it and fields.get("urgent"):
        raise ArgumentError(f"command {name!r}: an urgent command must be known by its whole text, without an argument")


class Resource:
    """A sensor, actuator, communication line or anything else behind the nine methods (Source: thesis §4.2.1).

    Override the methods that the hardware supports; the others raise UnsupportedError. Return values as Python values,
    numpy arrays or EALData.

    Attributes:
        types: the types it combines; every author sets it.
        value: type, unit and range of get_value and set_value, checked on every call if it is given.
        description: one line for people; the class's docstring's first line if empty.
        any_thread: whether its methods may run in any thread, one at a time, because they only compute. A caller that
            finds the actor idle may then run a call itself, which spares two thread switches. In lock step, one thread
            also takes the steps of all such resources' activities.
        name: the resource's name on its robot, set by the framework before `open`.

    Thread: every method runs in the resource's own actor, except with `any_thread`; none may block long.
    """

    types: ClassVar[ResourceType] = ResourceType.OTHER
    value: ClassVar[ValueInfo | None] = None
    description: ClassVar[str] = ""
    any_thread: ClassVar[bool] = False
    name: str = ""

    _reported_progress: tuple[float | None, str] | None = None
    _handlers: ClassVar[dict[tuple[str, str], str]] = {}
    _fields: ClassVar[dict[tuple[str, str], dict[str, Any]]] = {}

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls._handlers, cls._fields = {}, {}
        for base in reversed(cls.__mro__):  # mixins and several bases too
            for attribute, member in vars(base).items():
                if isinstance(member, _Setting):
                    for kind in ("config", "config_setter"):
                        cls._handlers[kind, attribute], cls._fields[kind, attribute] = attribute, member.fields
                elif mark := getattr(member, _MARK, None):
                    kind, name, fields = mark
                    before = cls._handlers.get((kind, name), attribute)
                    if before != attribute and before in vars(base):
                        raise ArgumentError(f"{cls.__name__}: {before} and {attribute} are both {kind} {name!r}")
                    cls._handlers[kind, name], cls._fields[kind, name] = attribute, fields

    # The nine methods.

    def get_status(self) -> int:
        """Return the status; its meaning is the resource's own (Source: thesis B.2.2.5)."""
        raise self._unsupported("get_status")

    def get_value(self) -> Any:
        """Return the sensor's value, or an activity that returns it later (Source: thesis B.2.3.1).

        Such an activity runs beside a motion and other calls; so do those of requests and configuration.
        """
        raise self._unsupported("get_value")

    def glance(self) -> Any:
        """Return the value if it is known without I/O, else None, the default.

        For callers that read many resources many times a second, such as a map of a hundred robots, for which a turn in
        each mailbox would cost far more than the values. Override it where `get_value` only reads memory. Thread: any,
        in parallel with all other methods, also before `open` and after `close`; it must be quick.
        """
        return None

    def set_value(self, data: EALData) -> Any:
        """Set the value; return a status int, None for success, or an activity (Source: thesis B.2.3.2)."""
        raise self._unsupported("set_value")

    def send_req(self, req: str) -> Any:
        """Answer a request (Source: thesis B.2.3.3). The default calls the methods under `@request`.

        Raises:
            ArgumentError: no such request, or a bad argument.
            UnsupportedError: the resource has no requests.
        """
        if not self.info().requests:
            raise self._unsupported("send_req")
        info, argument = self.info().parse_request(req)
        handler = self._handler("request", info.name)
        return handler() if argument is None else handler(argument.value)

    def send_cmd(self, cmd: str, data: EALData | None = None) -> Any:
        """Execute a command (Source: thesis B.2.3.4). The default calls the methods under `@command`.

        Raises:
            ArgumentError: no such command, or a bad argument.
            UnsupportedError: the resource has no commands.
        """
        own = self.info()
        if not own.commands:
            raise self._unsupported("send_cmd")
        info, argument = own.parse_command(cmd, data)
        handler = self._handler("command", info.name)
        return handler() if argument is None else handler(argument.value)

    def read_comm(self, length: int) -> Any:
        """Return up to `length` bytes, or an activity that returns them later (Source: thesis B.2.3.5).

        Such an activity runs beside a motion and other reads.
        """
        raise self._unsupported("read_comm")

    def write_comm(self, data: EALData, length: int) -> Any:
        """Write the first `length` bytes; return how many were written (Source: thesis B.2.3.6).

        An activity that writes them in pieces runs beside a motion, and a halt closes it.
        """
        raise self._unsupported("write_comm")

    def get_config(self, key: str) -> Any:
        """Return a configuration value (Source: thesis B.2.3.7). The default is a `setting` or `@config`.

        Raises:
            ArgumentError: no such key.
            UnsupportedError: the resource has no configuration.
        """
        if not self.info().configs:
            raise self._unsupported("get_config")
        return self._handler("config", self.info().config(key).name)()

    def set_config(self, key: str, data: EALData | None = None) -> Any:
        """Set a configuration value (Source: thesis B.2.3.8). The default is a `setting` or `@config_setter`.

        Raises:
            ArgumentError: no such key, a read-only key, or a value outside its type or range.
            UnsupportedError: the resource has no configuration.
        """
        if not self.info().configs:
            raise self._unsupported("set_config")
        value = self.info().config(key).checked(data).value
        return self._handler("config_setter", key)(value)

    # Lifecycle.

    def open(self) -> None:
        """Acquire the hardware; called once before the first call. An exception means: not available."""

    def close(self) -> None:
        """Release the hardware; called once after the last call, after `halt`."""

    def halt(self) -> None:
        """Stop everything that moves at once, until a new command.

        Called on a halt, a missed deadline, a crash and before `close`. Every actuator overrides it.
        """

    def not_ready(self) -> str | None:
        """Return why the device cannot be used at present, such as `cannot open /dev/ttyUSB0: ...`; None if it can.

        Called periodically, and before each call except stops, which then fails at once with NotReadyError; so it must
        be quick and do no I/O. It is for devices that come back by themselves: a wrong configuration is an error of
        `connect`.
        """
        return None

    def progress(self, fraction: float | None = None, text: str = "") -> None:
        """Report the progress of the running activity to its caller and to observers of the robot.

        Call it in an activity as often as you like; elsewhere it does nothing. The latest report of a step counts.
        `fraction` is the part that is done; below 0 counts as 0, above 1 as 1, and None is unknown. `text` is the
        present stage, for people. Raises ArgumentError if the fraction is no number.
        """
        if fraction is not None:
            if fraction != fraction:
                raise ArgumentError("progress needs a fraction from 0 to 1, not NaN")
            fraction = min(max(float(fraction), 0.0), 1.0)
        self._reported_progress = fraction, str(text)

    def background(self) -> Activity | None:
        """Return an activity that runs as long as the resource does, such as a poller; None for none.

        It runs between calls, in the same thread; an error in it restarts the resource.
        """
        return None

    # Information.

    def info(self) -> ResourceInfo:
        """Return the resource's information about itself; made once."""
        info: ResourceInfo | None = self.__dict__.get("_info")
        if info is None or info.name != (self.name or type(self).__name__):
            info = self.__dict__["_info"] = self._make_info()
        return info

    def _make_info(self) -> ResourceInfo:
        cls = type(self)
        commands, requests, configs = [], [], []
        for kind, name in self._handlers:
            fields = self._fields[kind, name]  # from the decorator, also where a subclass overrides without one
            if kind == "command":
                commands.append(CommandInfo(name=name, **fields))
            elif kind == "request":
                requests.append(CommandInfo(name=name, **fields))
            elif kind == "config":
                configs.append(ConfigInfo(name=name, writable=("config_setter", name) in self._handlers, **fields))
        methods = {method for method in METHODS if getattr(cls, method) is not getattr(Resource, method)}
        methods |= {method for method, served in (("send_cmd", commands), ("send_req", requests)) if served}
        if configs:
            methods |= {"get_config"} | ({"set_config"} if any(c.writable for c in configs) else set())
        return ResourceInfo(
            name=self.name or cls.__name__,
            types=self.types,
            methods=frozenset(methods),
            value=self.value,
            commands=tuple(commands),
            requests=tuple(requests),
            configs=tuple(configs),
            description=self.description or (cls.__doc__ or "").strip().partition("\n")[0],
        )

    def _handler(self, kind: str, name: str) -> Callable[..., Any]:
        attribute = self._handlers[kind, name]
        if isinstance(declared := getattr(type(self), attribute), _Setting):
            return partial(getattr, self, attribute) if kind == "config" else partial(declared.set, self)
        handler: Callable[..., Any] = getattr(self, attribute)
        return handler

    def _unsupported(self, method: str) -> UnsupportedError:
        name = self.name or type(self).__name__
        supported = ", ".join(m for m in METHODS if m in self.info().methods) or "nothing"
        return UnsupportedError(f"{name} does not support {method}; it supports {supported}")
