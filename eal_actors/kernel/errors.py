"""The errors of the framework; docs/reference/errors.md draws their tree.

Every error has a stable `code`, its name on the wire and in records. Errors of a resource carry `robot` and
`resource`, and show them in front of the message.
"""

from __future__ import annotations

import concurrent.futures
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import ClassVar, Self

from typing_extensions import override


class EALError(Exception):
    """The root of the tree: catch it to catch every error of the framework."""

    code: ClassVar[str] = "error"

    def __init_subclass__(cls, *, code: str | None = None) -> None:
        super().__init_subclass__()
        if code is not None:
            cls.code = code

    def __init__(self, message: str = "", *, robot: str | None = None, resource: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.robot = robot
        self.resource = resource

    def at(self, robot: str | None, resource: str | None = None) -> Self:
        """Name the robot and resource unless they are set already; return the error itself."""
        if self.robot is None:
            self.robot = robot
        if self.resource is None:
            self.resource = resource
        return self

    def copy(self) -> Self:
        """Return a copy: each caller raises its own, with its own traceback."""
        return type(self)(self.message, robot=self.robot, resource=self.resource)

    def __str__(self) -> str:
        where = "/".join(part for part in (self.robot, self.resource) if part)
        return f"{where}: {self.message}" if where else self.message


class DataError(EALError, ValueError, code="data"):
    """No EALData can hold the value, length or modifier (Source: thesis B.1)."""


def error_text(error: BaseException) -> str:
    """Return an exception as `Type: message`, or its type alone if it has no message or its `__str__` raises."""
    name = type(error).__name__
    try:
        return f"{name}: {error}" if str(error) else name
    except Exception:  # noqa: BLE001
        return name


def message_of(error: BaseException) -> str:
    """Return the message of an error of ours, without its robot; of any other one, its text with its type."""
    return error.message if isinstance(error, EALError) else error_text(error)


def code_of(error: BaseException) -> str:
    """Return the code of an error; that of EALError for one that is not ours."""
    return error.code if isinstance(error, EALError) else EALError.code


@dataclass(frozen=True, slots=True, order=True)
class Problem:
    """One error in a file.

    Attributes:
        file: the file's name as the user wrote it.
        line, column: counted from 1; 0 for the whole file.
        path: dotted path of the key, such as `robots.evbot1.timeout_s`; empty for the whole file.
        message: the error, and the valid alternatives.
    """

    file: str
    line: int
    column: int
    path: str
    message: str

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}:{self.column}" if self.line else self.file
        return f"{place}: {self.path}: {self.message}" if self.path else f"{place}: {self.message}"


class ConfigError(EALError, ValueError, code="config"):
    """A fleet, scenario, world or plugin file is invalid; all its `problems` at once, in the order of the file."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(sorted(problems))
        super().__init__("\n".join(str(problem) for problem in self.problems))
        self.args = (self.problems,)  # copying and unpickling construct it from these

    @override
    def copy(self) -> Self:
        return type(self)(self.problems).at(self.robot, self.resource)


def file_error(file: object, message: str, path: str = "") -> ConfigError:
    """Return the error of a whole file or folder, or of a key at a path whose line is not known."""
    return ConfigError([Problem(str(file), 0, 0, path, message)])


def unwritable_error(file: object, error: OSError) -> ConfigError:
    """Return the error of a file or folder that cannot be written."""
    return file_error(file, f"cannot be written: {error.strerror}")


@contextmanager
def writing(file: object) -> Iterator[None]:
    """Turn an OSError of the block into the error of a file or folder that cannot be written."""
    try:
        yield
    except OSError as error:
        raise unwritable_error(file, error) from error


class PluginError(EALError, RuntimeError, code="plugin"):
    """A plugin cannot be found or loaded, or does not provide what it names."""


class ResourceError(EALError, code="resource"):
    """An error of a single resource, or of a request to it."""


class ResourceNotFoundError(ResourceError, KeyError, code="resource_not_found"):
    """No resource has that name or id."""


class UnsupportedError(ResourceError, NotImplementedError, code="unsupported"):
    """The resource does not offer that method (Source: thesis §4.4.3)."""


class ArgumentError(ResourceError, ValueError, code="argument"):
    """An unknown command, request or configuration key, or an argument outside its type or range."""


class ReturnTypeError(ResourceError, TypeError, code="return_type"):
    """The resource returned a type other than its information declares."""


class ResourceFaultError(ResourceError, RuntimeError, code="resource_fault"):
    """The resource's own code raised; the original exception is the `__cause__`."""


class BlockedError(ResourceError, RuntimeError, code="blocked"):
    """The robot was halted because it does not come nearer to its goal; the message says what is in the way."""


class LocalizationError(ResourceError, RuntimeError, code="localization"):
    """The robot was halted because its pose is unknown, too old or too uncertain to drive by."""


class ResourceInUseError(ResourceError, RuntimeError, code="resource_in_use"):
    """Resources are still checked out at disconnect, or returned once too often (Source: thesis B.2.4)."""


class CallError(EALError, code="call"):
    """A call that did not complete."""


class DeadlineError(CallError, TimeoutError, code="deadline"):
    """The call's deadline passed; what it had started was halted."""


class WaitTimeoutError(CallError, TimeoutError, code="wait_timeout"):
    """The caller's own waiting time ended; the call itself continues."""


class BusyError(CallError, RuntimeError, code="busy"):
    """The mailbox is full; nothing was queued."""


class CallCancelledError(CallError, concurrent.futures.CancelledError, code="cancelled"):
    """The caller cancelled the call."""


class PreemptedError(CallError, RuntimeError, code="preempted"):
    """A newer command, or a halt, replaced this command."""


class StaleCommandError(CallError, RuntimeError, code="stale_command"):
    """The command arrived too late or a second time: the robot did not execute it."""


class ResourceBusyError(CallError, RuntimeError, code="resource_busy"):
    """Another controller, named in the message, holds the actuator; nothing was executed."""


class StoppedError(CallError, RuntimeError, code="stopped"):
    """An emergency stop holds the robot until `eal resume`; nothing was executed."""


class UnavailableError(CallError, ConnectionError, code="unavailable"):
    """The resource is restarting, stopped or gone: nothing was executed."""


class NotReadyError(UnavailableError, code="not_ready"):
    """The device is absent, off or not connected: nothing was executed, and the connection is retried automatically."""


class RobotError(EALError, code="robot"):
    """An error of a whole robot."""


class RobotNotFoundError(RobotError, KeyError, code="robot_not_found"):
    """The fleet has no robot of that name, tag or type."""


class RobotFailedError(RobotError, ConnectionError, code="robot_failed"):
    """The robot could not start, or crashed too often: it was stopped safely."""


class AccessDeniedError(RobotError, PermissionError, code="access_denied"):
    """The robot does not grant this to this controller."""


class ProtocolError(RobotError, ConnectionError, code="protocol"):
    """The other end of a connection speaks another version of the protocol, or sends invalid data."""


class RemoteError(RobotError, ConnectionError, code="remote"):
    """The operation is not possible through a network connection (Source: thesis §4.5)."""


class NavigationError(EALError, code="navigation"):
    """An error of a map, a path or a place."""


class PlaceNotFoundError(NavigationError, KeyError, code="place_not_found"):
    """The world has no place of that name."""


class NoPathError(NavigationError, RuntimeError, code="no_path"):
    """No path leads from the start to the goal, or the planner reached its bound before it found one."""


class ScenarioError(EALError, RuntimeError, code="scenario"):
    """A scenario cannot run on this fleet, or was not started properly."""
