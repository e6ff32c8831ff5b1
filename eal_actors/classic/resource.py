"""Resources in the thesis's form: for the authors of plugins, and as users check them out.

Source: thesis §4.2.1.1, §4.7.1, §4.7.2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Self

from eal_actors.classic.data import VOID, EALDataInfo_t, EALResourceInfo_t
from eal_actors.device.data import EALData
from eal_actors.device.resource import Resource
from eal_actors.kernel.errors import ResourceFaultError

FAILURE: Final = -1


class EALResource:
    """The nine methods of a resource; each returns None, or -1 for a status, unless it is overridden."""

    def getStatus(self) -> int:
        """Source: thesis B.2.2.5."""
        return FAILURE

    def getValue(self) -> EALDataInfo_t | None:
        """Source: thesis B.2.3.1."""
        return None

    def setValue(self, data: EALDataInfo_t | None) -> int:
        """Source: thesis B.2.3.2."""
        return FAILURE

    def sendReq(self, req: str) -> EALDataInfo_t | None:
        """Source: thesis B.2.3.3."""
        return None

    def sendCmd(self, cmd: str, data: EALDataInfo_t | None) -> int:
        """Source: thesis B.2.3.4."""
        return FAILURE

    def readComm(self, data: EALDataInfo_t | None, length: int) -> int:
        """Fill `data` with up to `length` bytes; return the number read (Source: thesis B.2.3.5)."""
        return FAILURE

    def writeComm(self, data: EALDataInfo_t | None, length: int) -> int:
        """Source: thesis B.2.3.6."""
        return FAILURE

    def getConfig(self, config: str) -> EALDataInfo_t | None:
        """Source: thesis B.2.3.7."""
        return None

    def setConfig(self, config: str, data: EALDataInfo_t | None) -> int:
        """Source: thesis B.2.3.8."""
        return FAILURE


METHODS: Final = tuple(name for name in vars(EALResource) if not name.startswith("_"))
"""The nine methods in the thesis's names."""


class EALBaseResource(EALResource, Resource):
    """The base of a resource that is written as in the thesis.

    Override the thesis's methods that the hardware supports. A method that returns None for data has failed. An
    actuator overrides `halt` too, which the thesis lacks. The constructor sets `info_`, whose `type` names the types of
    the resource. Thread: every method runs in the resource's own actor; none may block long.
    """

    info_: EALResourceInfo_t
    types = property(lambda self: self.info_.type)  # the thesis sets them in the instance

    def __new__(cls, *_args: Any, **_named: Any) -> Self:
        """Make the resource with its `info_`."""
        resource = super().__new__(cls)
        resource.info_ = EALResourceInfo_t()  # as in C++, even if the author's constructor does not call the base's
        return resource

    def __init_subclass__(cls, **kwargs: Any) -> None:
        for name, (method, served) in _SERVED.items():
            if getattr(cls, name) is not getattr(EALResource, name):  # the framework lists what is overridden
                setattr(cls, method, served)
        super().__init_subclass__(**kwargs)


def _not_null(data: Any, method: str) -> Any:
    if data is None:
        raise ResourceFaultError(f"{method} returned NULL, which means that it failed")
    return data


def _or_null(data: EALData | None) -> EALDataInfo_t | None:
    return None if data is None else EALDataInfo_t.of(data)


def _read_comm(resource: EALResource, length: int) -> bytes:
    data = EALDataInfo_t(VOID, bytes(length), length, isPtr=True)
    count = resource.readComm(data, length)
    if not 0 <= count <= length:
        raise ResourceFaultError(f"readComm of {length} bytes returned {count}")
    return bytes(data.__eal_data__().payload)[:count]


_SERVED: Final[dict[str, tuple[str, Callable[..., Any]]]] = {
    "getStatus": ("get_status", lambda self: self.getStatus()),
    "getValue": ("get_value", lambda self: _not_null(self.getValue(), "getValue")),
    "setValue": ("set_value", lambda self, data: self.setValue(EALDataInfo_t.of(data))),
    "sendReq": ("send_req", lambda self, req: _not_null(self.sendReq(req), "sendReq")),
    "sendCmd": ("send_cmd", lambda self, cmd, data=None: self.sendCmd(cmd, _or_null(data))),
    "readComm": ("read_comm", _read_comm),
    "writeComm": ("write_comm", lambda self, data, length: self.writeComm(EALDataInfo_t.of(data), length)),
    "getConfig": ("get_config", lambda self, key: _not_null(self.getConfig(key), "getConfig")),
    "setConfig": ("set_config", lambda self, key, data=None: self.setConfig(key, _or_null(data))),
}
"""By the thesis's method: the framework's method, and the function that serves it."""
