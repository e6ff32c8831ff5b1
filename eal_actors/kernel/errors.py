"""The errors of the framework.

    EALError
    ├── DataError               (ValueError)        no EALData can hold the value
    ├── ConfigError             (ValueError)        a file is invalid; it carries every problem
    ├── PluginError             (RuntimeError)      a plugin cannot be loaded, or does not provide what it names
    ├── ResourceError
    │   ├── ResourceNotFoundError (KeyError)        no resource of that name or id
    │   ├── UnsupportedError    (NotImplementedError) the resource lacks that method
    │   ├── ArgumentError       (ValueError)        unknown command, or an argument outside its type or range
    │   ├── ReturnTypeError     (TypeError)         the resource returned an invalid type
    │   ├── ResourceFaultError  (RuntimeError)      the resource's own code raised
    │   ├── BlockedError        (RuntimeError)      the robot does not come nearer to its goal
    │   ├── LocalizationError   (RuntimeError)      the robot's pose is too old or too uncertain to drive by
    │   └── ResourceInUseError  (RuntimeError)      resources are still checked out
    ├── CallError
    │   ├── DeadlineError       (TimeoutError)      no answer before the call's deadline
    │   ├── WaitTimeoutError    (TimeoutError)      the caller stopped waiting; the call continues
    │   ├── BusyError           (RuntimeError)      the mailbox is full
    │   ├── CallCancelledError  (CancelledError)    the caller cancelled the call
    │   ├── PreemptedError      (RuntimeError)      a newer command or a halt replaced the command
    │   ├── StaleCommandError   (RuntimeError)      a late or repeated command; it was not executed
    │   ├── ResourceBusyError   (RuntimeError)      another controller holds the actuator
    │   ├── StoppedError        (RuntimeError)      an emergency stop holds until it is resumed
    │   └── UnavailableError    (ConnectionError)   the resource is restarting, stopped or gone
    │       └── NotReadyError                       its device is absent; it is retried automatically
    ├── RobotError
    │   ├── RobotNotFoundError  (KeyError)          no robot of that name, tag or type
    │   ├── RobotFailedError    (ConnectionError)   the robot gave up and was stopped safely
    │   ├── AccessDeniedError   (PermissionError)   the robot does not grant this to this controller
    │   ├── ProtocolError       (ConnectionError)   the other end speaks another version, or sends invalid data
    │   └── RemoteError         (ConnectionError)   not possible through a network connection
    ├── NavigationError
    │   ├── PlaceNotFoundError  (KeyError)          the world has no place of that name
    │   └── NoPathError         (RuntimeError)      no path leads to the goal, or none was found in time
    └── ScenarioError           (RuntimeError)      a scenario cannot run on this fleet

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


class DataError(EALError, ValueError):
    """No EALData can hold the value, length or modifier (Source: thesis B.1)."""

    code = "data"


def error_text(error: BaseException) -> str:
    """Return an exception as `Type: message`, or its type alone if its `__str__` raises."""
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:  # noqa: BLE001
        return type(error).__name__


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
        line: 1-based line, 0 for the whole file.
        column: 1-based column, 0 for the whole file.
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


class ConfigError(EALError, ValueError):
    """A fleet, scenario, world or plugin file is invalid; all its problems at once.

    Attributes:
        problems: the problems, in the order of the file.
    """

    code = "config"

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


class PluginError(EALError, RuntimeError):
    """A plugin cannot be found or loaded, or does not provide what it names."""

    code = "plugin"


class ResourceError(EALError):
    """An error of a single resource, or of a request to it."""

    code = "resource"


class ResourceNotFoundError(ResourceError, KeyError):
    """No resource has that name or id."""

    code = "resource_not_found"


class UnsupportedError(ResourceError, NotImplementedError):
    """The resource does not offer that method (Source: thesis §4.4.3)."""

    code = "unsupported"


class ArgumentError(ResourceError, ValueError):
    """An unknown command, request or configuration key, or an argument outside its type or range."""

    code = "argument"


class ReturnTypeError(ResourceError, TypeError):
    """The resource returned a type other than its information declares."""

    code = "return_type"


class ResourceFaultError(ResourceError, RuntimeError):
    """The resource's own code raised; the original exception is the `__cause__`."""

    code = "resource_fault"


class BlockedError(ResourceError, RuntimeError):
    """The robot was halted because it does not come nearer to its goal; the message says what is in the way."""

    code = "blocked"


class LocalizationError(ResourceError, RuntimeError):
    """The robot was halted because its pose is unknown, too old or too uncertain to drive by."""

    code = "localization"


class ResourceInUseError(ResourceError, RuntimeError):
    """Resources are still checked out at disconnect, or returned once too often (Source: thesis B.2.4)."""

    code = "resource_in_use"


class CallError(EALError):
    """A call that did not complete."""

    code = "call"


class DeadlineError(CallError, TimeoutError):
    """The call's deadline passed; what it had started was halted."""

    code = "deadline"


class WaitTimeoutError(CallError, TimeoutError):
    """The caller's own waiting time ended; the call itself continues."""

    code = "wait_timeout"


class BusyError(CallError, RuntimeError):
    """The mailbox is full; nothing was queued."""

    code = "busy"


class CallCancelledError(CallError, concurrent.futures.CancelledError):
    """The caller cancelled the call."""

    code = "cancelled"


class PreemptedError(CallError, RuntimeError):
    """A newer command, or a halt, replaced this command."""

    code = "preempted"


class StaleCommandError(CallError, RuntimeError):
    """The command arrived too late or a second time: the robot did not execute it."""

    code = "stale_command"


class ResourceBusyError(CallError, RuntimeError):
    """Another controller, named in the message, holds the actuator; nothing was executed."""

    code = "resource_busy"


class StoppedError(CallError, RuntimeError):
    """An emergency stop holds the robot until `eal resume`; nothing was executed."""

    code = "stopped"


class UnavailableError(CallError, ConnectionError):
    """The resource is restarting, stopped or gone: nothing was executed."""

    code = "unavailable"


class NotReadyError(UnavailableError):
    """The device is absent, off or not connected: nothing was executed, and the connection is retried automatically."""

    code = "not_ready"


class RobotError(EALError):
    """An error of a whole robot."""

    code = "robot"


class RobotNotFoundError(RobotError, KeyError):
    """The fleet has no robot of that name, tag or type."""

    code = "robot_not_found"


class RobotFailedError(RobotError, ConnectionError):
    """The robot could not start, or crashed too often: it was stopped safely."""

    code = "robot_failed"


class AccessDeniedError(RobotError, PermissionError):
    """The robot does not grant this to this controller."""

    code = "access_denied"


class ProtocolError(RobotError, ConnectionError):
    """The other end of a connection speaks another version of the protocol, or sends invalid data."""

    code = "protocol"


class RemoteError(RobotError, ConnectionError):
    """The operation is not possible through a network connection (Source: thesis §4.5)."""

    code = "remote"


class NavigationError(EALError):
    """An error of a map, a path or a place."""

    code = "navigation"


class PlaceNotFoundError(NavigationError, KeyError):
    """The world has no place of that name."""

    code = "place_not_found"


class NoPathError(NavigationError, RuntimeError):
    """No path leads from the start to the goal, or the planner reached its bound before it found one."""

    code = "no_path"


class ScenarioError(EALError, RuntimeError):
    """A scenario cannot run on this fleet, or was not started properly."""

    code = "scenario"
