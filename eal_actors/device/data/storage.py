"""Checks of values against their C types, and their conversion into bytes and back.

The common values, plain numbers and numpy arrays, do not come here: see `EALData.of`.
"""

from __future__ import annotations

import math
import struct
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from eal_actors.device.data.c_types import (
    ARRAY_BY_DTYPE,
    BUILTINS,
    BYTES,
    C_TYPES,
    DOUBLE,
    INT,
    MOST_DIMENSIONS,
    NUMBERS,
    PLAIN,
    SCALAR_BY_DTYPE,
    TEXT,
    VOID,
    CType,
    DataType,
    int_c_type,
    is_numpy,
    short_repr,
)
from eal_actors.kernel.errors import DataError

if TYPE_CHECKING:
    import numpy as np

Payload = bytes | memoryview
Stored = tuple[Any, Payload | None, int, tuple[int, ...] | None]
"""The content of an EALData: value, payload, length and shape; value or payload may be None until it is needed."""
_SCALARS: Final = {c_type.code: struct.Struct(f"<{c_type.code}") for c_type in C_TYPES.values()}
PLAIN_NUMBERS: Final = {
    c_type.full_name: _SCALARS[c_type.code].unpack
    for c_type in C_TYPES.values()
    if not c_type.is_ptr and c_type.code not in "cs?"
}
"""By its C type, what reads a number that is no array; any bytes of the right length are one."""


def infer(value: Any) -> tuple[CType, Any]:
    """Return the C type of a value that is no plain int, float or bool."""
    is_array = is_numpy(value, "ndarray")
    if is_array and hasattr(value, "mask"):
        raise DataError("a masked numpy array has no type; give what stands for its masked elements: array.filled(...)")
    if is_array or is_numpy(value, "generic"):
        c_type = (ARRAY_BY_DTYPE if is_array else SCALAR_BY_DTYPE).get(value.dtype.str)
        if c_type is None:
            raise DataError(f"numpy dtype {value.dtype.str} has no type here, only {', '.join(ARRAY_BY_DTYPE)}")
        return c_type, value
    if value is None:
        return VOID, None
    if isinstance(value, str):
        return TEXT, value
    if isinstance(value, (bytes, bytearray, memoryview)):
        return BYTES, value
    if isinstance(value, (list, tuple)):
        return _infer_list(value)
    if isinstance(value, int):
        return int_c_type(int(value), int(value), is_ptr=False), value
    if isinstance(value, float):
        return DOUBLE, value
    raise DataError(
        f"no type fits {short_repr(value)}, a {type(value).__name__}; "
        "there are types for bool, int, float, str, bytes, None, lists of numbers and numpy arrays"
    )


def _infer_list(values: Sequence[Any]) -> tuple[CType, Sequence[Any]]:
    if not values:
        return BYTES, b""
    values = _without_numpy(values)
    kinds = set(map(type, values))
    if kinds == {bool}:
        return C_TYPES[DataType.BOOL, True, *PLAIN], values
    if bool not in kinds and all(issubclass(kind, int) for kind in kinds):
        return int_c_type(min(values), max(values), is_ptr=True), values
    if bool not in kinds and all(issubclass(kind, (int, float)) for kind in kinds):
        return C_TYPES[DataType.DOUBLE, True, *PLAIN], values
    names = ", ".join(sorted(kind.__name__ for kind in kinds))
    raise DataError(f"a list of {names} has no type; all elements must be bools, or all must be ints and floats")


def _without_numpy(values: Sequence[Any]) -> Sequence[Any]:
    """Return the values with Python numbers in place of numpy scalars."""
    if set(map(type, values)) <= BUILTINS:
        return values
    return [value.item() if is_numpy(value, "generic") else value for value in values]


def store(c_type: CType, value: Any, length: int | None) -> Stored:
    """Check a value against its C type and length, and return the content of its EALData."""
    if length is not None and (type(length) is not int or length < 0):
        raise DataError(f"length: {short_repr(length)} is no number of bytes")
    if c_type == TEXT:
        return _store_text(value, length)
    if is_numpy(value, "ndarray"):
        stored = _store_array(c_type, value)
    elif not c_type.is_ptr:
        stored = _store_scalar(c_type, value)
    else:
        stored = _store_sequence(c_type, value)
    needed = stored[2]
    if length is not None and length != needed:
        hint = "; is_long=True makes an int 8 bytes" if c_type == INT and length == 8 else ""
        raise DataError(f"length: this {c_type.full_name} takes {needed} bytes, not {length}{hint}")
    return stored


def _store_sequence(c_type: CType, value: Any) -> Stored:
    if c_type.type is DataType.VOID:
        if not isinstance(value, (bytes, bytearray, memoryview)):
            raise DataError(f"void[]: {short_repr(value)} is no bytes")
        packed = bytes(value)
        return packed, packed, len(packed), None
    if not isinstance(value, (list, tuple)):
        array = f" or numpy array of dtype {c_type.dtype}" if c_type.dtype else ""
        raise DataError(f"{c_type.name}[]: {short_repr(value)} is no list or tuple{array}")
    packed = _pack_elements(c_type, _without_numpy(value))
    return None, packed, len(packed), None


def _store_scalar(c_type: CType, value: Any) -> Stored:
    if c_type == VOID:
        if value is not None:
            raise DataError(f"void: {short_repr(value)} is not None; bytes need is_ptr=True")
        return None, b"", 0, None
    if is_numpy(value, "generic"):
        value = value.item()
    if c_type.code == "c":
        code = ord(value) if isinstance(value, str) and len(value) == 1 else value
        if isinstance(code, bool) or not isinstance(code, int) or not 0 <= code < 128:
            hint = "; more characters need is_ptr=True" if isinstance(value, str) and len(value) > 1 else ""
            raise DataError(f"char: {short_repr(value)} is not {c_type.takes}{hint}")
        return chr(code), None, c_type.width, None
    if (packed := _pack_element(c_type, value)) is None:
        raise DataError(f"{c_type.name}: {short_repr(value)} is not {c_type.takes}")
    return struct.unpack(f"<{c_type.code}", packed)[0], packed, c_type.width, None


def _store_text(value: Any, length: int | None) -> Stored:
    if not isinstance(value, str):
        raise DataError(f"char[]: {short_repr(value)} is no str; for numbers there is unsigned char, for bytes VOID")
    if "\0" in value:
        raise DataError(f"char[]: {short_repr(value)} holds a zero character, where text ends in C")
    value = str.__str__(value)  # additions of a subclass are not transferred
    try:
        needed = len(value) if value.isascii() else len(value.encode())
    except UnicodeEncodeError as error:
        raise DataError(f"char[]: {short_repr(value)} is no UTF-8 text: {error.reason}") from error
    if length is not None and length < needed:
        raise DataError(f"length: the text takes {needed} bytes, more than {length}")
    return value, None, needed if length is None else length, None


def _store_array(c_type: CType, array: np.ndarray[Any, Any]) -> Stored:
    if not c_type.is_ptr or c_type.dtype != array.dtype.str:
        allowed = f"an array of dtype {c_type.dtype}" if c_type.is_ptr and c_type.dtype else "no numpy array"
        hint = "; arrays need is_ptr=True" if not c_type.is_ptr else ""
        raise DataError(f"{c_type.full_name}: given a numpy array of dtype {array.dtype.str}, takes {allowed}{hint}")
    import numpy as np

    view = array.view(np.ndarray)
    view.flags.writeable = False
    return view, None, view.nbytes, view.shape


def _pack_elements(c_type: CType, values: Sequence[Any]) -> bytes:
    if all(_is_element(c_type, kind) for kind in set(map(type, values))):
        try:
            return struct.pack(f"<{len(values)}{c_type.code}", *values)
        except (struct.error, OverflowError):
            pass
    index = next(index for index, value in enumerate(values) if _pack_element(c_type, value) is None)
    raise DataError(f"{c_type.name}[{index}]: {short_repr(values[index])} is not {c_type.takes}")


def _is_element(c_type: CType, kind: type) -> bool:
    return kind is bool if c_type.type is DataType.BOOL else kind is not bool and issubclass(kind, NUMBERS[c_type.type])


def _pack_element(c_type: CType, value: object) -> bytes | None:
    """Pack one number, or return None if it does not fit."""
    if not _is_element(c_type, type(value)):
        return None
    try:
        return struct.pack(f"<{c_type.code}", value)
    except (struct.error, OverflowError):
        return None


def as_bytes(payload: bytes | bytearray | memoryview) -> Payload:
    """Return the payload itself, as read-only bytes."""
    if isinstance(payload, bytes):
        return payload
    try:
        view = memoryview(payload)
    except TypeError as error:
        raise DataError(f"payload: {short_repr(payload)} is no bytes, bytearray or memoryview") from error
    if not view.c_contiguous:
        raise DataError("payload: the memoryview is not contiguous")
    return view.cast("B").toreadonly() if view.nbytes else b""


def read(c_type: CType, payload: Payload) -> Stored:
    """Check bytes against their C type; numbers in arrays are read when they are needed."""
    length = len(payload)
    if not c_type.is_ptr:
        if length != c_type.width:
            raise DataError(f"payload: {c_type.name} takes {c_type.width} bytes, not {length}")
        if c_type.code in "cs":
            return _store_scalar(c_type, payload[0] if length else None)
        return _SCALARS[c_type.code].unpack(payload)[0], payload, length, None
    if length % c_type.width:
        raise DataError(f"payload: {length} bytes are no whole number of {c_type.name}, {c_type.width} bytes each")
    if c_type == TEXT:
        try:
            return bytes(payload).partition(b"\0")[0].decode(), payload, length, None
        except UnicodeDecodeError as error:
            raise DataError(f"payload: no UTF-8 text at byte {error.start}: {error.reason}") from error
    return None, payload, length, None


def checked_shape(c_type: CType, length: int, shape: Sequence[int] | None, dtype: str | None) -> tuple[int, ...]:
    """Return the shape of an array rebuilt from its payload, or raise DataError."""
    if shape is None or dtype is None:
        raise DataError(f"shape {short_repr(shape)} and dtype {short_repr(dtype)} must be given together")
    taken = c_type.dtype if c_type.is_ptr else None
    if dtype != taken:
        takes = taken or "no numpy array"
        raise DataError(f"dtype: {short_repr(dtype)} does not fit {c_type.full_name}, which takes {takes}")
    if not isinstance(shape, (list, tuple)) or len(shape) > MOST_DIMENSIONS:
        raise DataError(f"shape: {short_repr(shape)} is no list of at most {MOST_DIMENSIONS} sizes")
    if any(type(size) is not int or size < 0 for size in shape):
        raise DataError(f"shape: {short_repr(shape)} holds what is no size, an int from 0")
    if math.prod(shape) * c_type.width != length:
        raise DataError(f"shape: {short_repr(shape)} of {c_type.width} bytes each does not fit {length} bytes")
    if math.prod(size or 1 for size in shape) * c_type.width > sys.maxsize:
        raise DataError(f"shape: {short_repr(shape)} is too large for an array, even without elements")
    return tuple(shape)


def pack(c_type: CType, value: Any, length: int, shape: tuple[int, ...] | None) -> Payload:
    """Return the payload of a checked value."""
    if value is None:
        return b""
    if isinstance(value, str):
        return value.encode().ljust(length, b"\0")
    if shape is not None:  # a view that steps through another array, such as [::-1], has no bytes in a row
        block = value if value.flags.c_contiguous else value.copy()
        return memoryview(block.reshape(-1).view("u1")).toreadonly()
    return _SCALARS[c_type.code].pack(value)


def unpack(c_type: CType, payload: Payload) -> list[Any]:
    """Return the elements of a payload as Python values."""
    return list(struct.unpack(f"<{len(payload) // c_type.width}{c_type.code}", payload))


def as_array(payload: Payload, shape: tuple[int, ...], c_type: CType) -> np.ndarray[Any, Any]:
    """Return a numpy array on top of the payload, without a copy."""
    try:
        import numpy as np
    except ImportError as error:
        raise DataError(f"value: an array of dtype {c_type.dtype} needs numpy; `payload` serves without") from error
    return np.ndarray(shape, c_type.dtype, buffer=payload)
