"""The thesis's data structures: mutable, with the modifiers as separate fields."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

from eal_actors.device.data import DataType, EALData
from eal_actors.device.data.c_types import TEXT, CType, find_c_type
from eal_actors.device.info import ResourceInfo, ResourceType
from eal_actors.kernel.errors import DataError

INT, CHAR, FLOAT = DataType.INT, DataType.CHAR, DataType.FLOAT
DOUBLE, BOOL, VOID = DataType.DOUBLE, DataType.BOOL, DataType.VOID
SENSOR, ACTUATOR = ResourceType.SENSOR, ResourceType.ACTUATOR
COMMUNICATION, OTHER = ResourceType.COMMUNICATION, ResourceType.OTHER
_MOST_BYTES: Final = 2**31 - 1  # the thesis's length is an int
ISPTR: Final = True
ISUNSIGNED: Final = True
ISSHORT: Final = True
ISLONG: Final = True

EALDataType_t = DataType


@dataclass
class EALDataInfo_t:
    """A value with its C type (Source: thesis table B.1).

    Attributes:
        data: the payload: a Python value; or bytes, the memory of an array. 0 and None, the null pointer, are zeros.
        length: the payload's bytes; 0 derives it from the type and the payload.
        isPtr: it is an array or text.
    """

    type: DataType = INT
    data: Any = 0
    length: int = 0
    isPtr: bool = False
    isUnsigned: bool = False
    isShort: bool = False
    isLong: bool = False

    @classmethod
    def of(cls, data: EALData) -> EALDataInfo_t:
        """Return a copy of an EALData, without its unit, frame and time."""
        return cls(data.type, data.value, data.length, data.is_ptr, data.is_unsigned, data.is_short, data.is_long)

    def __eal_data__(self) -> EALData:
        """Return the value as EALData; see EALData.of."""
        self._require_length()
        if self.data is None or (type(self.data) is int and self.data == 0):
            return self._from_memory(bytes(self.length or (0 if self.isPtr else self._c_type.width)))
        if isinstance(self.data, bytes) and self.isPtr:
            return self._from_memory(self.data.ljust(self.length, b"\0"))
        return EALData(self.type, self.data, self.length or None, **self._modifiers)

    def require_room(self, length: int) -> None:
        """Raise DataError unless the payload's memory can hold so many bytes."""
        room = self.length or (length if self.isPtr else self._c_type.width)
        if length > room:
            raise DataError(
                f"{length} bytes do not fit into the {room} of this EALDataInfo_t; create it with room for them, such "
                f"as EALDataInfo_t(CHAR, '', {length}, ISPTR)"
            )

    def fill(self, read: bytes) -> int:
        """Replace the payload's memory and keep its type; return the number of bytes. What follows them is zero.

        Text that contains a zero byte, or is not UTF-8, becomes bytes. Raises DataError if the bytes are no value of
        the type.
        """
        c_type = self._c_type
        if c_type == TEXT:
            try:
                self.data = read if b"\0" in read else read.decode()
            except UnicodeDecodeError:
                self.data = read
            return len(read)
        self._require_length()
        size = max(self.length, -(-len(read) // c_type.width) * c_type.width if self.isPtr else c_type.width)
        self.data = self._from_memory(read.ljust(size, b"\0")).value
        return len(read)

    def _require_length(self) -> None:
        if not 0 <= self.length <= _MOST_BYTES:
            raise DataError(f"length must be a number of bytes from 0 to {_MOST_BYTES}, not {self.length}")

    @property
    def _modifiers(self) -> dict[str, Any]:
        return {"is_ptr": self.isPtr, "is_unsigned": self.isUnsigned, "is_short": self.isShort, "is_long": self.isLong}

    @property
    def _c_type(self) -> CType:
        return find_c_type(self.type, **self._modifiers)

    def _from_memory(self, memory: bytes) -> EALData:
        is_text = self._c_type == TEXT  # unsigned: bytes need not be text
        return EALData.from_payload(self.type, memory, **{**self._modifiers, "is_unsigned": is_text or self.isUnsigned})


EALData_t = EALDataInfo_t
"""The thesis's pointer to an EALDataInfo_t (Source: thesis B.1.3); every Python name is one."""


@dataclass
class EALResourceInfo_t:
    """The information of a resource (Source: thesis §4.4.2); it has the attributes of ResourceInfo too.

    A resource sets `type`, the types that it combines, in its constructor (Source: thesis table 4.4).
    """

    name: str = ""
    type: ResourceType = OTHER
    _info: ResourceInfo | None = field(default=None, repr=False)

    @classmethod
    def of(cls, info: ResourceInfo) -> EALResourceInfo_t:
        """Return the information that a resource gives about itself."""
        return cls(info.name, info.types, info)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._info, name)
