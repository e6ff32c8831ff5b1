"""Connections in the thesis's form: EALconnect, EALdisconnect and the EAL with its fifteen methods."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

from eal_actors.classic.data import EALDataInfo_t, EALResourceInfo_t
from eal_actors.classic.resource import FAILURE, METHODS, EALResource
from eal_actors.device.resource import Resource
from eal_actors.facade import eal as facade
from eal_actors.facade.tasks import TaskGroup
from eal_actors.kernel.errors import ArgumentError, EALError
from eal_actors.kernel.log import get_logger

T = TypeVar("T")

EALResourceId_t = int


def EALconnect(host: str | None = None, port: int = facade.DEFAULT_PORT) -> EAL | None:
    """Connect to a robot; None if it cannot be reached (Source: thesis B.2.1.1)."""
    try:
        return EAL(facade.connect(host, port))
    except EALError as error:
        get_logger().warning("EALconnect failed", host=host, port=port, reason=str(error))
        return None


def EALdisconnect(eal: EAL | None) -> None:
    """Close a connection; refused, with a log line, while resources are checked out (Source: thesis B.2.1.2)."""
    if eal is not None:
        eal._attempt(eal._eal.disconnect, None)  # both are one API


def _given(data: EALDataInfo_t | None) -> EALDataInfo_t:
    if data is None:
        raise ArgumentError("the data is NULL; the call needs an EALDataInfo_t")
    return data


class EAL:
    """A connection with the thesis's names.

    `timeout_s` is the time, by the fleet's clock, until each call fails; None for the fleet file's default.
    """

    def __init__(self, eal: facade.EAL) -> None:
        self._eal = eal
        self.timeout_s: float | None = None

    @staticmethod
    def _attempt(action: Callable[[], T], failure: T) -> T:
        try:
            return action()
        except EALError as error:
            get_logger().warning("call failed", reason=str(error), code=error.code)
            return failure

    def _data(self, call: Callable[..., Any], *arguments: Any) -> EALDataInfo_t | None:
        return self._attempt(lambda: EALDataInfo_t.of(call(*arguments, timeout_s=self.timeout_s)), None)

    def _status(self, call: Callable[..., int], *arguments: Any) -> int:
        return self._attempt(lambda: call(*arguments, timeout_s=self.timeout_s), FAILURE)

    def tasks(self) -> TaskGroup:
        """Return a group of tasks, for calls that run at the same time (Source: thesis §6.2.3).

        At `rate: max`, time stands while a thread waits for another one by other means.
        """
        return self._eal.tasks()

    def getResourceList(self) -> list[str]:
        """Source: thesis B.2.2.1."""
        return self._eal.get_resource_list()

    def findResource(self, resourceName: str) -> int:
        """Source: thesis B.2.2.2."""
        return self._attempt(lambda: self._eal.find_resource(resourceName), FAILURE)

    def resourceInfo(self, id: int) -> EALResourceInfo_t | None:
        """Source: thesis B.2.2.3."""
        return self._attempt(lambda: EALResourceInfo_t.of(self._eal.resource_info(id)), None)

    def resourceInfoByName(self, resourceName: str) -> EALResourceInfo_t | None:
        """Source: thesis B.2.2.4."""
        return self._attempt(lambda: EALResourceInfo_t.of(self._eal.resource_info_by_name(resourceName)), None)

    def getStatus(self, id: int) -> int:
        """Source: thesis B.2.2.5."""
        return self._status(self._eal.get_status, id)

    def getValue(self, id: int) -> EALDataInfo_t | None:
        """Source: thesis B.2.3.1."""
        return self._data(self._eal.get_value, id)

    def setValue(self, id: int, data: EALDataInfo_t | None) -> int:
        """Source: thesis B.2.3.2."""
        return self._status(lambda **named: self._eal.set_value(id, _given(data), **named))

    def sendReq(self, id: int, req: str) -> EALDataInfo_t | None:
        """Source: thesis B.2.3.3."""
        return self._data(self._eal.send_req, id, req)

    def sendCmd(self, id: int, cmd: str, data: EALDataInfo_t | None) -> int:
        """Source: thesis B.2.3.4."""
        return self._status(self._eal.send_cmd, id, cmd, data)

    def readComm(self, id: int, data: EALDataInfo_t | None, length: int) -> int:
        """Fill `data`, which keeps its type; return the number of bytes read (Source: thesis B.2.3.5)."""

        def read(**named: Any) -> int:
            _given(data).require_room(length)
            return _given(data).fill(bytes(self._eal.read_comm(id, length, **named).payload))

        return self._status(read)

    def writeComm(self, id: int, data: EALDataInfo_t | None, length: int) -> int:
        """Source: thesis B.2.3.6."""
        return self._status(lambda **named: self._eal.write_comm(id, _given(data), length, **named))

    def getConfig(self, id: int, config: str) -> EALDataInfo_t | None:
        """Source: thesis B.2.3.7."""
        return self._data(self._eal.get_config, id, config)

    def setConfig(self, id: int, config: str, data: EALDataInfo_t | None) -> int:
        """Source: thesis B.2.3.8."""
        return self._status(self._eal.set_config, id, config, data)

    def getResource(self, resourceName: str) -> EALResource | None:
        """Check out a resource of this process; None if that is not possible (Source: thesis B.2.4.1)."""
        return self._attempt(lambda: _CheckedOutResource(self, resourceName), None)

    def returnResource(self, resource: EALResource | None) -> int:
        """Return a checked-out resource; 1, or -1 if it is none (Source: thesis B.2.4.2)."""
        lent = resource._resource if isinstance(resource, _CheckedOutResource) else resource
        return self._attempt(lambda: self._eal.return_resource(lent), FAILURE)  # type: ignore[arg-type]  # it checks


class _CheckedOutResource(EALResource):
    """A resource as its user holds it: the nine methods, and the members of the resource's own class.

    Departs from B.2.4.1: the nine methods pass through the resource's mailbox, so that a stop ends what they began. Its
    own members bypass the mailbox.
    """

    _resource: Resource

    def __init__(self, eal: EAL, name: str) -> None:
        members: dict[str, Any] = {"_resource": eal._eal.get_resource(name)}
        members |= {method: partial(getattr(eal, method), eal.findResource(name)) for method in METHODS}
        vars(self).update(members)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._resource, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self._resource, name, value)
