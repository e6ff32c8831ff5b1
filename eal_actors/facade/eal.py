"""EAL: the seventeen calls of the thesis, synchronous, for simple scripts."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self, TypeVar

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.device.data import EALData
from eal_actors.device.info import ResourceInfo
from eal_actors.device.resource import Resource
from eal_actors.facade.elsewhere import FLEET_VARIABLE, endpoint_of, fleet_at, robot_at, unknown_robot
from eal_actors.facade.fleet import Fleet
from eal_actors.facade.shared import acquire_fleet, acquire_fleet_at, occupy, release_fleet, vacate
from eal_actors.kernel.bundled import bundled_path, find_file
from eal_actors.kernel.errors import RemoteError, RobotNotFoundError, UnavailableError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.resources import EALResourceManager

T = TypeVar("T")

DEFAULT_PORT: Final = 50000
"""The thesis's port (Source: thesis table 6.3)."""


def connect(host: str | None = None, port: int = DEFAULT_PORT, *, fleet: str | Path | Fleet | None = None) -> EAL:
    """Connect to one robot (Source: thesis B.2.1.1).

    Without arguments it is the thesis's local case: the sample plugin in this process.

    Args:
        host: the robot's name in the fleet, or the machine that serves it: a host name or IP address, or an endpoint
            such as `tls/host:50000`; None where the fleet has just one robot. A robot that is served somewhere need
            not be in any fleet file.
        port: the port of a robot's server, where `host` is a machine; a robot with a name needs none.
        fleet: a fleet file, the name of one that comes with the framework, such as `sim`, or a connected Fleet; None
            takes what $EAL_FLEET names, else the bundled `local`. Connections of one process to the same file share
            one fleet.

    Raises:
        ConfigError: what is wrong with the fleet file.
        RobotNotFoundError: the fleet has no such robot, or several and none was named, and there is no such machine;
            or several robots are reached there.
        RobotFailedError: the robot could not start.
        UnavailableError: the robot has not started in time, or nobody answers, or the fleet given is not connected.

    Thread: blocks the caller while the robot starts.
    """
    if isinstance(fleet, Fleet):
        return EAL(_choose(fleet, host, port))
    path = find_file(fleet or os.environ.get(FLEET_VARIABLE) or bundled_path("fleets/local.yaml"), "fleet")
    config = EALConfigManager.load(path).fleet
    if host is None or robot_at(config, host, port) is not None:
        opened = acquire_fleet(path)
    else:
        endpoint = endpoint_of(config, host, port)
        opened, host = acquire_fleet_at(endpoint, lambda: fleet_at(endpoint, config)), None
    try:
        return EAL(_choose(opened, host, port), opened)
    except BaseException:
        release_fleet(opened)
        raise


def _choose(fleet: Fleet, host: str | None, port: int) -> RobotHandle:
    if not fleet:
        raise UnavailableError(f"fleet {fleet.name!r} is not connected: use `with fleet:` or fleet.connect()")
    if host is None:
        if len(fleet) != 1:
            raise RobotNotFoundError(f"fleet {fleet.name!r} has {len(fleet)} robots; name one of {', '.join(fleet)}")
        host = next(iter(fleet))
    name = robot_at(fleet.config, host, port)
    if name is None:
        raise unknown_robot(fleet.config, host, port)
    robot = fleet[name]
    robot.require_started()
    return robot


class EAL:
    """A connection to one robot: the thesis's API in PEP 8 names, with typed errors in place of -1 and NULL.

    Each call waits for its answer, at most until its deadline: `timeout_s` in seconds of the fleet's clock, or the
    fleet file's default. It raises DeadlineError then, ResourceNotFoundError for an unknown id, UnsupportedError
    where the resource lacks the method, ArgumentError where it refuses an argument, ResourceFaultError where its
    own code raised, UnavailableError and BusyError where it cannot take the call.

    Use it in a `with` statement, or call `disconnect`. Thread: any; every call blocks its caller.
    """

    def __init__(self, robot: RobotHandle, owned_fleet: Fleet | None = None) -> None:
        self._robot = robot
        self._owned_fleet = owned_fleet
        self._manager: EALResourceManager[ResourceHandle] = EALResourceManager(robot)
        self._is_open = True
        if owned_fleet is not None:
            occupy(robot)

    def __repr__(self) -> str:
        return f"<EAL {self._robot.name}>"

    # Connection.

    def disconnect(self) -> None:
        """Close the connection (Source: thesis B.2.1.2).

        The last connection of this process to a robot halts it; where the caller gave `connect` an open Fleet, its
        robots are the caller's to halt. Calls raise UnavailableError from now on.

        Raises:
            ResourceInUseError: resources are still checked out; the connection stays open (thesis B.2.4).
        """
        self._manager.check_all_returned()
        self._release()

    def _release(self) -> None:
        self._is_open = False
        fleet, self._owned_fleet = self._owned_fleet, None
        if fleet is not None:
            vacate(self._robot)
            release_fleet(fleet)

    def _handle(self, resource_id: int) -> ResourceHandle:
        if not self._is_open:
            raise UnavailableError("this connection is closed; connect again", robot=self._robot.name)
        return self._manager.get(resource_id)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._release()  # also when something is still out: leaving the block must stop the motors
        if error is None:
            self._manager.check_all_returned()

    # Resource knowledge.

    def get_resource_list(self) -> list[str]:
        """Return the names of the resources (Source: thesis B.2.2.1)."""
        return self._manager.names()

    def find_resource(self, name: str) -> int:
        """Return the id of a resource, valid in this connection only (Source: thesis B.2.2.2).

        Raises:
            ResourceNotFoundError: there is none of that name.
        """
        return self._manager.find(name)

    def resource_info(self, resource_id: int) -> ResourceInfo:
        """Return what a resource says of itself (Source: thesis B.2.2.3)."""
        return self._handle(resource_id).info

    def resource_info_by_name(self, name: str) -> ResourceInfo:
        """Return what a named resource says of itself (Source: thesis B.2.2.4)."""
        return self._handle(self._manager.find(name)).info

    def get_status(self, resource_id: int, *, timeout_s: float | None = None) -> int:
        """Return a resource's status; its meaning is the resource's own (Source: thesis B.2.2.5)."""
        return self._wait(self._handle(resource_id).get_status(timeout_s=timeout_s))

    # Structured resource access.

    def get_value(self, resource_id: int, *, timeout_s: float | None = None) -> EALData:
        """Return a resource's value (Source: thesis B.2.3.1)."""
        return self._wait(self._handle(resource_id).get_value(timeout_s=timeout_s))

    def set_value(self, resource_id: int, value: Any, *, timeout_s: float | None = None) -> int:
        """Set a resource's value; return its status int (Source: thesis B.2.3.2)."""
        return self._wait(self._handle(resource_id).set_value(value, timeout_s=timeout_s))

    def send_req(self, resource_id: int, req: str, *, timeout_s: float | None = None) -> EALData:
        """Return what a resource answers to a request (Source: thesis B.2.3.3)."""
        return self._wait(self._handle(resource_id).send_req(req, timeout_s=timeout_s))

    def send_cmd(self, resource_id: int, cmd: str, data: Any = None, *, timeout_s: float | None = None) -> int:
        """Carry out a command and wait for its end; return its status int (Source: thesis B.2.3.4)."""
        return self._wait(self._handle(resource_id).send_cmd(cmd, data, timeout_s=timeout_s))

    def read_comm(self, resource_id: int, length: int, *, timeout_s: float | None = None) -> EALData:
        """Return up to `length` bytes read (Source: thesis B.2.3.5)."""
        return self._wait(self._handle(resource_id).read_comm(length, timeout_s=timeout_s))

    def write_comm(
        self, resource_id: int, data: Any, length: int | None = None, *, timeout_s: float | None = None
    ) -> int:
        """Write the first `length` bytes; return how many were written (Source: thesis B.2.3.6)."""
        return self._wait(self._handle(resource_id).write_comm(data, length, timeout_s=timeout_s))

    def get_config(self, resource_id: int, key: str, *, timeout_s: float | None = None) -> EALData:
        """Return a configuration value (Source: thesis B.2.3.7)."""
        return self._wait(self._handle(resource_id).get_config(key, timeout_s=timeout_s))

    def set_config(self, resource_id: int, key: str, value: Any = None, *, timeout_s: float | None = None) -> int:
        """Set a configuration value; return a status int (Source: thesis B.2.3.8)."""
        return self._wait(self._handle(resource_id).set_config(key, value, timeout_s=timeout_s))

    @staticmethod
    def _wait(future: Future[T]) -> T:
        try:
            return future.get()
        except KeyboardInterrupt:
            future.cancel()  # nobody waits for it any more: stop what it moves
            raise

    # Direct resource access.

    def get_resource(self, name: str) -> Resource:
        """Check out the resource object itself (Source: thesis B.2.4.1).

        For debugging: its actor goes on using it, and nothing keeps the two of you apart. Each one checked out must
        be returned before `disconnect`.
        """
        resource = self._handle(self._manager.find(name)).resource()
        self._manager.check_out(name, resource)
        return resource

    def return_resource(self, resource: Resource) -> int:
        """Return a resource object; answers 1 (Source: thesis B.2.4.2).

        Raises:
            ResourceInUseError: it is not checked out.
            RemoteError: the robot is in another process, and never lent one.
        """
        if self._robot.is_remote:
            raise RemoteError("resources of a robot in another process cannot be lent", robot=self._robot.name)
        self._manager.check_in(resource)
        return 1

    @contextmanager
    def borrowed(self, name: str) -> Iterator[Resource]:
        """Check out a resource object for the length of a `with` block."""
        resource = self.get_resource(name)
        try:
            yield resource
        finally:
            self.return_resource(resource)
