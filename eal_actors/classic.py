"""The thesis's names and return conventions, so that its programs can be ported line by line.

`EALconnect` returns an EAL or None. Calls that return data return an EALDataInfo_t or None. Calls that return a status
return an int, -1 for "not found" and for every failure, which is logged with its reason. New programs should use
`eal_actors.connect` or `Fleet`, which raise errors.

Source: thesis §4.4, appendix B.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import ResourceInfo, ResourceType
from eal_actors.device.resource import Resource
from eal_actors.facade import eal as facade
from eal_actors.kernel.errors import EALError
from eal_actors.kernel.log import get_logger

__all__ = [
    "ACTUATOR",
    "BOOL",
    "CHAR",
    "COMMUNICATION",
    "DOUBLE",
    "EAL",
    "FLOAT",
    "INT",
    "ISLONG",
    "ISPTR",
    "ISSHORT",
    "ISUNSIGNED",
    "OTHER",
    "SENSOR",
    "VOID",
    "EALDataInfo_t",
    "EALResourceId_t",
    "EALconnect",
    "EALdisconnect",
]

T = TypeVar("T")

INT, CHAR, FLOAT = DataType.INT, DataType.CHAR, DataType.FLOAT
DOUBLE, BOOL, VOID = DataType.DOUBLE, DataType.BOOL, DataType.VOID
SENSOR, ACTUATOR = ResourceType.SENSOR, ResourceType.ACTUATOR
COMMUNICATION, OTHER = ResourceType.COMMUNICATION, ResourceType.OTHER
ISPTR: Final = True
ISUNSIGNED: Final = True
ISSHORT: Final = True
ISLONG: Final = True

EALResourceId_t = int
FAILURE: Final = -1


@dataclass
class EALDataInfo_t:
    """The thesis's mutable data structure (Source: thesis table B.1).

    Attributes:
        type: the payload's type.
        data: the payload, as a Python value.
        length: the payload's bytes; 0 derives it from the type and the payload.
        isPtr: it is an array or text.
        isUnsigned: its type is unsigned.
        isShort: its type is short.
        isLong: its type is long.
    """

    type: DataType = INT
    data: Any = 0
    length: int = 0
    isPtr: bool = False
    isUnsigned: bool = False
    isShort: bool = False
    isLong: bool = False

    @classmethod
    def _from(cls, data: EALData) -> EALDataInfo_t:
        return cls(data.type, data.value, data.length, data.is_ptr, data.is_unsigned, data.is_short, data.is_long)

    def _pack(self) -> EALData:
        return EALData(
            self.type,
            self.data,
            self.length or None,
            is_ptr=self.isPtr,
            is_unsigned=self.isUnsigned,
            is_short=self.isShort,
            is_long=self.isLong,
        )


def EALconnect(host: str | None = None, port: int = facade.DEFAULT_PORT) -> EAL | None:
    """Connect to a robot; None if it cannot be reached (Source: thesis B.2.1.1)."""
    try:
        return EAL(facade.connect(host, port))
    except EALError as error:
        get_logger().warning("EALconnect failed", host=host, port=port, reason=str(error))
        return None


def EALdisconnect(eal: EAL) -> None:
    """Close a connection; refused, with a log line, while resources are checked out (Source: thesis B.2.1.2)."""
    eal._attempt(eal._eal.disconnect, None)  # both are one API


class EAL:
    """A connection with the thesis's names."""

    def __init__(self, eal: facade.EAL) -> None:
        self._eal = eal

    @staticmethod
    def _attempt(action: Callable[[], T], failure: T) -> T:
        try:
            return action()
        except EALError as error:
            get_logger().warning("call failed", reason=str(error), code=error.code)
            return failure

    def _data(self, action: Callable[[], EALData]) -> EALDataInfo_t | None:
        return self._attempt(lambda: EALDataInfo_t._from(action()), None)

    def getResourceList(self) -> list[str]:
        """Source: thesis B.2.2.1."""
        return self._eal.get_resource_list()

    def findResource(self, resourceName: str) -> int:
        """Source: thesis B.2.2.2."""
        return self._attempt(lambda: self._eal.find_resource(resourceName), FAILURE)

    def resourceInfo(self, id: int) -> ResourceInfo | None:
        """Source: thesis B.2.2.3."""
        return self._attempt(lambda: self._eal.resource_info(id), None)

    def resourceInfoByName(self, resourceName: str) -> ResourceInfo | None:
        """Source: thesis B.2.2.4."""
        return self._attempt(lambda: self._eal.resource_info_by_name(resourceName), None)

    def getStatus(self, id: int) -> int:
        """Source: thesis B.2.2.5."""
        return self._attempt(lambda: self._eal.get_status(id), FAILURE)

    def getValue(self, id: int) -> EALDataInfo_t | None:
        """Source: thesis B.2.3.1."""
        return self._data(lambda: self._eal.get_value(id))

    def setValue(self, id: int, data: EALDataInfo_t) -> int:
        """Source: thesis B.2.3.2."""
        return self._attempt(lambda: self._eal.set_value(id, data._pack()), FAILURE)

    def sendReq(self, id: int, req: str) -> EALDataInfo_t | None:
        """Source: thesis B.2.3.3."""
        return self._data(lambda: self._eal.send_req(id, req))

    def sendCmd(self, id: int, cmd: str, data: EALDataInfo_t | None) -> int:
        """Source: thesis B.2.3.4."""
        return self._attempt(lambda: self._eal.send_cmd(id, cmd, data._pack() if data else None), FAILURE)

    def readComm(self, id: int, data: EALDataInfo_t, length: int) -> int:
        """Fill `data` with up to `length` bytes; return the number read (Source: thesis B.2.3.5)."""
        read = self._data(lambda: self._eal.read_comm(id, length))
        if read is None:
            return FAILURE
        data.type, data.data, data.length, data.isPtr = read.type, read.data, read.length, read.isPtr
        return read.length

    def writeComm(self, id: int, data: EALDataInfo_t, length: int) -> int:
        """Source: thesis B.2.3.6."""
        return self._attempt(lambda: self._eal.write_comm(id, data._pack(), length), FAILURE)

    def getConfig(self, id: int, config: str) -> EALDataInfo_t | None:
        """Source: thesis B.2.3.7."""
        return self._data(lambda: self._eal.get_config(id, config))

    def setConfig(self, id: int, config: str, data: EALDataInfo_t | None) -> int:
        """Source: thesis B.2.3.8."""
        return self._attempt(lambda: self._eal.set_config(id, config, data._pack() if data else None), FAILURE)

    def getResource(self, resourceName: str) -> Resource | None:
        """Source: thesis B.2.4.1."""
        return self._attempt(lambda: self._eal.get_resource(resourceName), None)

    def returnResource(self, resource: Resource) -> int:
        """Source: thesis B.2.4.2."""
        return self._attempt(lambda: self._eal.return_resource(resource), FAILURE)
