"""EAL: the synchronous API of the thesis's seventeen calls, for one robot."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from typing_extensions import override

from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.device.data import EALData
from eal_actors.device.info import ResourceInfo
from eal_actors.device.resource import Resource
from eal_actors.facade.blocking import BlockingParts
from eal_actors.facade.connections import (
    acquire_fleet,
    acquire_remote_fleet,
    add_connection,
    find_robot,
    release_fleet,
    remove_connection,
    resolve_endpoint,
    unknown_robot,
)
from eal_actors.facade.fleet import Fleet
from eal_actors.facade.shutdown import is_to_close
from eal_actors.facade.tasks import TaskGroup
from eal_actors.kernel.bundled import FLEET_VARIABLE, bundled_path, find_file
from eal_actors.kernel.errors import RemoteError, RobotNotFoundError, UnavailableError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.resources import EALResourceManager

DEFAULT_PORT: Final = 50000
"""The thesis's port (Source: thesis table 6.3)."""


def connect(host: str | None = None, port: int = DEFAULT_PORT, *, fleet: str | Path | Fleet | None = None) -> EAL:
    """Connect to one robot (Source: thesis B.2.1.1).

    Without arguments it is the thesis's local case: the sample plugin in this process.

    Args:
        host: the robot's name in the fleet; or the host name, IP address or endpoint (such as `tls/host:50000`) of the
            machine that serves it, which need not be in a fleet file. None if the fleet has one robot.
        port: the port of the robot's server, if `host` is a host name or IP address.
        fleet: a fleet file, the name of a bundled one such as `sim`, or a connected Fleet. None takes the file that
            $EAL_FLEET names, or the bundled `local`. Connections of one process to the same file share one fleet.

    Raises:
        ConfigError: the fleet file is invalid.
        RobotNotFoundError: neither the fleet nor the network has the robot; or there are several and none was named.
        RobotFailedError: the robot could not start.
        UnavailableError: the robot has not started in time, or nobody answers, or the fleet given is not connected.

    Thread: blocks the caller while the robot starts.
    """
    if not isinstance(host, str | None):
        raise TypeError(f"connect takes the name of one robot, not {host!r}; a Fleet connects many")
    if isinstance(fleet, Fleet):
        return EAL(_select_robot(fleet, host, port))
    path = find_file(fleet or os.environ.get(FLEET_VARIABLE) or bundled_path("fleets/local.yaml"), "fleet")
    config = EALConfigManager.load(path).fleet
    if host is None or find_robot(config, host, port) is not None:
        opened = acquire_fleet(path)
    else:
        opened, host = acquire_remote_fleet(resolve_endpoint(config, host, port), config), None
    try:
        return EAL(_select_robot(opened, host, port), opened)
    except BaseException:
        release_fleet(opened)
        raise


def _select_robot(fleet: Fleet, host: str | None, port: int) -> RobotHandle:
    if not fleet:
        raise UnavailableError(f"fleet {fleet.name!r} is not connected: use `with fleet:` or fleet.connect()")
    if host is None:
        if len(fleet) != 1:
            raise RobotNotFoundError(f"fleet {fleet.name!r} has {len(fleet)} robots; name one of {', '.join(fleet)}")
        host = next(iter(fleet))
    if (name := find_robot(fleet.config, host, port)) is None:
        raise unknown_robot(fleet.config, host, port)
    robot = fleet[name]
    robot.require_started()
    return robot


class EAL(BlockingParts):
    """A connection to one robot: the thesis's API in PEP 8 names, with typed errors in place of -1 and NULL.

    Each call waits for its result until its deadline: `timeout_s` in seconds of the fleet's clock, or the fleet file's
    default. It raises DeadlineError after that, ResourceNotFoundError for an unknown id, UnsupportedError if the
    resource lacks the method, ArgumentError if it refuses an argument, ResourceFaultError if its own code raised, and
    UnavailableError or BusyError if it cannot accept the call.

    Use it in a `with` statement, or call `disconnect`. Thread: any; every call blocks its caller.
    """

    def __init__(self, robot: RobotHandle, owned_fleet: Fleet | None = None) -> None:
        self._robot = robot
        self._owned_fleet = owned_fleet
        self._manager: EALResourceManager[ResourceHandle] = EALResourceManager(robot)
        self._is_open = True
        self._is_released = False
        self._release_lock = threading.RLock()  # a handler of a signal may interrupt a release and disconnect again
        if owned_fleet is not None:
            add_connection(robot)

    def __repr__(self) -> str:
        return f"<EAL {self._robot.name}>"

    # Connection.

    def tasks(self, timeout_s: float | None = None) -> TaskGroup:
        """Return a group of tasks that run at the same time, on the fleet's clock; see `Fleet.tasks`.

        Raises UnavailableError if this connection is closed.
        """
        return TaskGroup(self._open_robot().clock, timeout_s)

    def disconnect(self) -> None:
        """Close the connection (Source: thesis B.2.1.2).

        The last connection of this process to a robot halts it, unless `connect` was given an open Fleet. Later calls
        raise UnavailableError. Raises ResourceInUseError if resources are still checked out; the connection stays open
        (thesis B.2.4). A second call returns when the first one has.
        """
        self._manager.check_all_returned()
        self._release()

    def _release(self) -> None:
        self._is_open = False
        fleet = self._owned_fleet
        if fleet is None or not is_to_close(fleet.close):  # in a child of a fork, nobody would release the lock
            return
        with self._release_lock:
            if not self._is_released:
                self._is_released = True
                remove_connection(self._robot)
                release_fleet(fleet)

    @override
    def _open_robot(self) -> RobotHandle:
        if not self._is_open:
            raise UnavailableError("this connection is closed; connect again", robot=self._robot.name)
        return self._robot

    def _handle(self, resource_id: int) -> ResourceHandle:
        self._open_robot()
        return self._manager.get(resource_id)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._release()  # first: leaving the block must stop the motors even if resources are checked out
        if error is None:
            self._manager.check_all_returned()

    # Resource knowledge.

    def get_resource_list(self) -> list[str]:
        """Return the names of the resources (Source: thesis B.2.2.1)."""
        return self._manager.names()

    def find_resource(self, name: str) -> int:
        """Return the id of a resource, valid in this connection only (Source: thesis B.2.2.2).

        Raises ResourceNotFoundError if the robot has no such resource.
        """
        return self._manager.find(name)

    def resource_info(self, resource_id: int) -> ResourceInfo:
        """Return the description of a resource (Source: thesis B.2.2.3)."""
        return self._handle(resource_id).info

    def resource_info_by_name(self, name: str) -> ResourceInfo:
        """Return the description of a resource by its name (Source: thesis B.2.2.4)."""
        return self._handle(self._manager.find(name)).info

    def get_status(self, resource_id: int, *, timeout_s: float | None = None) -> int:
        """Return a resource's status, whose meaning the resource defines (Source: thesis B.2.2.5)."""
        return self._handle(resource_id).get_status(timeout_s=timeout_s).get()

    # Structured resource access.

    def get_value(self, resource_id: int, *, timeout_s: float | None = None) -> EALData:
        """Return a resource's value (Source: thesis B.2.3.1)."""
        return self._handle(resource_id).get_value(timeout_s=timeout_s).get()

    def set_value(self, resource_id: int, value: Any, *, timeout_s: float | None = None) -> int:
        """Set a resource's value; return its status int (Source: thesis B.2.3.2)."""
        return self._handle(resource_id).set_value(value, timeout_s=timeout_s).get()

    def send_req(self, resource_id: int, req: str, *, timeout_s: float | None = None) -> EALData:
        """Return the answer to a request (Source: thesis B.2.3.3)."""
        return self._handle(resource_id).send_req(req, timeout_s=timeout_s).get()

    def send_cmd(self, resource_id: int, cmd: str, data: Any = None, *, timeout_s: float | None = None) -> int:
        """Execute a command to its end; return its status int (Source: thesis B.2.3.4)."""
        return self._handle(resource_id).send_cmd(cmd, data, timeout_s=timeout_s).get()

    def read_comm(self, resource_id: int, length: int, *, timeout_s: float | None = None) -> EALData:
        """Read up to `length` bytes (Source: thesis B.2.3.5)."""
        return self._handle(resource_id).read_comm(length, timeout_s=timeout_s).get()

    def write_comm(
        self, resource_id: int, data: Any, length: int | None = None, *, timeout_s: float | None = None
    ) -> int:
        """Write the first `length` bytes; return the number written (Source: thesis B.2.3.6)."""
        return self._handle(resource_id).write_comm(data, length, timeout_s=timeout_s).get()

    def get_config(self, resource_id: int, key: str, *, timeout_s: float | None = None) -> EALData:
        """Return a configuration value (Source: thesis B.2.3.7)."""
        return self._handle(resource_id).get_config(key, timeout_s=timeout_s).get()

    def set_config(self, resource_id: int, key: str, value: Any = None, *, timeout_s: float | None = None) -> int:
        """Set a configuration value; return a status int (Source: thesis B.2.3.8)."""
        return self._handle(resource_id).set_config(key, value, timeout_s=timeout_s).get()

    # Direct resource access.

    def get_resource(self, name: str) -> Resource:
        """Check out the resource object itself (Source: thesis B.2.4.1).

        For debugging: its actor still uses it, without synchronization. Return it before `disconnect`.
        """
        resource = self._handle(self._manager.find(name)).resource()
        self._manager.check_out(name, resource)
        return resource

    def return_resource(self, resource: Resource) -> int:
        """Return a resource object that was checked out; the result is 1 (Source: thesis B.2.4.2).

        Raises:
            ResourceInUseError: it is not checked out.
            RemoteError: the robot is in another process.
        """
        if self._robot.is_remote:
            raise RemoteError("resources of a robot in another process cannot be checked out", robot=self._robot.name)
        self._manager.check_in(resource)
        return 1

    @contextmanager
    def borrowed(self, name: str) -> Iterator[Resource]:
        """Check out a resource object for a `with` block."""
        resource = self.get_resource(name)
        try:
            yield resource
        finally:
            self.return_resource(resource)
