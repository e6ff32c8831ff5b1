"""Check a value against its C type, and turn it into bytes and back."""

from __future__ import annotations

import math
import struct
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from eal_actors.device.data.forms import (
    ARRAY_BY_DTYPE,
    BUILTINS,
    BYTES,
    DOUBLE,
    FORMS,
    INT,
    MOST_DIMENSIONS,
    NUMBERS,
    PLAIN,
    SCALAR_BY_DTYPE,
    TEXT,
    VOID,
    DataType,
    Form,
    int_form,
    is_numpy,
    shown,
)
from eal_actors.kernel.errors import DataError

if TYPE_CHECKING:
    import numpy as np

Payload = bytes | memoryview
Stored = tuple[Any, Payload | None, int, tuple[int, ...] | None]
"""What an EALData keeps: value, payload, length and shape; value or payload may be None until it is asked for."""


def infer(value: Any) -> tuple[Form, Any]:
    """Choose the form for a value that is no plain int, float or bool."""
    is_array = is_numpy(value, "ndarray")
    if is_array or is_numpy(value, "generic"):
        form = (ARRAY_BY_DTYPE if is_array else SCALAR_BY_DTYPE).get(value.dtype.str)
        if form is None:
            raise DataError(f"numpy dtype {value.dtype.str} has no type here, only {', '.join(ARRAY_BY_DTYPE)}")
        return form, value
    if value is None:
        return VOID, None
    if isinstance(value, str):
        return TEXT, value
    if isinstance(value, (bytes, bytearray, memoryview)):
        return BYTES, value
    if isinstance(value, (list, tuple)):
        return _infer_list(value)
    if isinstance(value, int):
        return int_form(int(value), int(value), is_ptr=False), value
    if isinstance(value, float):
        return DOUBLE, value
    raise DataError(
        f"no type fits {shown(value)}, a {type(value).__name__}; "
        "there are types for bool, int, float, str, bytes, None, lists of numbers and numpy arrays"
    )


def _infer_list(values: Sequence[Any]) -> tuple[Form, Sequence[Any]]:
    if not values:
        return BYTES, b""
    values = _without_numpy(values)
    kinds = set(map(type, values))
    if kinds == {bool}:
        return FORMS[DataType.BOOL, True, *PLAIN], values
    if bool not in kinds and all(issubclass(kind, int) for kind in kinds):
        return int_form(min(values), max(values), is_ptr=True), values
    if bool not in kinds and all(issubclass(kind, (int, float)) for kind in kinds):
        return FORMS[DataType.DOUBLE, True, *PLAIN], values
    names = ", ".join(sorted(kind.__name__ for kind in kinds))
    raise DataError(f"a list of {names} has no type; all elements must be bools, or all must be ints and floats")


def _without_numpy(values: Sequence[Any]) -> Sequence[Any]:
    """Turn numpy scalars into Python numbers."""
    if set(map(type, values)) <= BUILTINS:
        return values
    return [value.item() if is_numpy(value, "generic") else value for value in values]


def store(form: Form, value: Any, length: int | None) -> Stored:
    """Check a value against its form and its length, and return what an EALData keeps of it."""
    if length is not None and (type(length) is not int or length < 0):
        raise DataError(f"length: {shown(length)} is no number of bytes")
    if form == TEXT:
        return _store_text(value, length)
    if is_numpy(value, "ndarray"):
        stored = _store_array(form, value)
    elif not form.is_ptr:
        stored = _store_scalar(form, value)
    else:
        stored = _store_sequence(form, value)
    needed = stored[2]
    if length is not None and length != needed:
        hint = "; is_long=True makes an int 8 bytes" if form == INT and length == 8 else ""
        raise DataError(f"length: this {form.name}{'[]' * form.is_ptr} takes {needed} bytes, not {length}{hint}")
    return stored


def _store_sequence(form: Form, value: Any) -> Stored:
    if form.type is DataType.VOID:
        if not isinstance(value, (bytes, bytearray, memoryview)):
            raise DataError(f"void[]: {shown(value)} is no bytes")
        packed = bytes(value)
        return packed, packed, len(packed), None
    if not isinstance(value, (list, tuple)):
        array = f" or numpy array of dtype {form.dtype}" if form.dtype else ""
        raise DataError(f"{form.name}[]: {shown(value)} is no list or tuple{array}")
    packed = _pack_elements(form, _without_numpy(value))
    return None, packed, len(packed), None


def _store_scalar(form: Form, value: Any) -> Stored:
    if form == VOID:
        if value is not None:
            raise DataError(f"void: {shown(value)} is not None; bytes need is_ptr=True")
        return None, b"", 0, None
    if is_numpy(value, "generic"):
        value = value.item()
    if form.code == "c":
        code = ord(value) if isinstance(value, str) and len(value) == 1 else value
        if isinstance(code, bool) or not isinstance(code, int) or not 0 <= code < 128:
            hint = "; more characters need is_ptr=True" if isinstance(value, str) and len(value) > 1 else ""
            raise DataError(f"char: {shown(value)} is not {form.takes}{hint}")
        return chr(code), None, form.width, None
    packed = _pack_element(form, value)
    if packed is None:
        raise DataError(f"{form.name}: {shown(value)} is not {form.takes}")
    return struct.unpack(f"<{form.code}", packed)[0], packed, form.width, None


def _store_text(value: Any, length: int | None) -> Stored:
    if not isinstance(value, str):
        raise DataError(f"char[]: {shown(value)} is no str; for numbers there is unsigned char, for bytes VOID")
    if "\0" in value:
        raise DataError(f"char[]: {shown(value)} holds a zero character, where text ends in C")
    value = str.__str__(value)  # what a subclass adds does not cross
    try:
        needed = len(value) if value.isascii() else len(value.encode())
    except UnicodeEncodeError as error:
        raise DataError(f"char[]: {shown(value)} is no UTF-8 text: {error.reason}") from error
    if length is not None and length < needed:
        raise DataError(f"length: the text takes {needed} bytes, more than {length}")
    return value, None, needed if length is None else length, None


def _store_array(form: Form, array: np.ndarray[Any, Any]) -> Stored:
    if not form.is_ptr or form.dtype != array.dtype.str:
        allowed = f"an array of dtype {form.dtype}" if form.is_ptr and form.dtype else "no numpy array"
        hint = "; arrays need is_ptr=True" if not form.is_ptr else ""
        name = f"{form.name}{'[]' * form.is_ptr}"
        raise DataError(f"{name}: given a numpy array of dtype {array.dtype.str}, takes {allowed}{hint}")
    view = array.view()
    view.flags.writeable = False
    return view, None, view.nbytes, view.shape


def _pack_elements(form: Form, values: Sequence[Any]) -> bytes:
    if all(_is_element(form, kind) for kind in set(map(type, values))):
        try:
            return struct.pack(f"<{len(values)}{form.code}", *values)
        except (struct.error, OverflowError):
            pass
    index = next(index for index, value in enumerate(values) if _pack_element(form, value) is None)
    raise DataError(f"{form.name}[{index}]: {shown(values[index])} is not {form.takes}")


def _is_element(form: Form, kind: type) -> bool:
    return kind is bool if form.type is DataType.BOOL else kind is not bool and issubclass(kind, NUMBERS[form.type])


def _pack_element(form: Form, value: object) -> bytes | None:
    """Pack one number, or return None if it does not fit."""
    if not _is_element(form, type(value)):
        return None
    try:
        return struct.pack(f"<{form.code}", value)
    except (struct.error, OverflowError):
        return None


def as_bytes(payload: bytes | bytearray | memoryview) -> Payload:
    """Return the payload itself, read-only and as bytes."""
    if isinstance(payload, bytes):
        return payload
    try:
        view = memoryview(payload)
    except TypeError as error:
        raise DataError(f"payload: {shown(payload)} is no bytes, bytearray or memoryview") from error
    if not view.c_contiguous:
        raise DataError("payload: the memoryview is not contiguous")
    return view.cast("B").toreadonly() if view.nbytes else b""


def read(form: Form, payload: Payload) -> Stored:
    """Check bytes against their form; numbers in arrays are read when they are asked for."""
    length = len(payload)
    if not form.is_ptr and length != form.width:
        raise DataError(f"payload: {form.name} takes {form.width} bytes, not {length}")
    if form.is_ptr and length % form.width:
        raise DataError(f"payload: {length} bytes are no whole number of {form.name}, {form.width} bytes each")
    if form.type is DataType.VOID:
        return None, payload, length, None
    if form == TEXT:
        try:
            return bytes(payload).partition(b"\0")[0].decode(), payload, length, None
        except UnicodeDecodeError as error:
            raise DataError(f"payload: no UTF-8 text at byte {error.start}: {error.reason}") from error
    if form.is_ptr:
        return None, payload, length, None
    return _store_scalar(form, payload[0] if form.code == "c" else struct.unpack(f"<{form.code}", payload)[0])


def checked_meta(unit: object, frame_id: object, stamp_s: object) -> float | None:
    """Return the time stamp as a float, or raise DataError for what unit, frame or stamp may not be."""
    for name, text in (("unit", unit), ("frame_id", frame_id)):
        if text is not None and not isinstance(text, str):
            raise DataError(f"{name}: {shown(text)} is no str")
    if stamp_s is None:
        return None
    if isinstance(stamp_s, bool) or not isinstance(stamp_s, (int, float)) or not abs(stamp_s) <= sys.float_info.max:
        raise DataError(f"stamp_s: {shown(stamp_s)} is no finite number of seconds")
    return float(stamp_s)


def checked_shape(form: Form, length: int, shape: Sequence[int] | None, dtype: str | None) -> tuple[int, ...]:
    """Return the shape of an array rebuilt from its payload, or raise DataError."""
    if shape is None or dtype is None:
        raise DataError(f"shape {shown(shape)} and dtype {shown(dtype)} must be given together")
    if not form.is_ptr or form.dtype is None or dtype != form.dtype:
        takes = form.dtype if form.is_ptr and form.dtype else "no numpy array"
        raise DataError(f"dtype: {shown(dtype)} does not fit {form.name}{'[]' * form.is_ptr}, which takes {takes}")
    if not isinstance(shape, (list, tuple)) or len(shape) > MOST_DIMENSIONS:
        raise DataError(f"shape: {shown(shape)} is no list of at most {MOST_DIMENSIONS} sizes")
    if any(type(size) is not int or size < 0 for size in shape):
        raise DataError(f"shape: {shown(shape)} holds what is no size, an int from 0")
    if math.prod(shape) * form.width != length:
        raise DataError(f"shape: {shown(shape)} of {form.width} bytes each does not fit {length} bytes")
    if math.prod(size or 1 for size in shape) * form.width > sys.maxsize:
        raise DataError(f"shape: {shown(shape)} is too large for an array, even without elements")
    return tuple(shape)


def unpack(form: Form, payload: Payload) -> list[Any]:
    """Return the elements of a payload as Python values."""
    return list(struct.unpack(f"<{len(payload) // form.width}{form.code}", payload))


def as_array(payload: Payload, shape: tuple[int, ...], form: Form) -> np.ndarray[Any, Any]:
    """Return a numpy array on top of the payload, without a copy."""
    try:
        import numpy as np
    except ImportError as error:
        raise DataError(f"value: an array of dtype {form.dtype} needs numpy; `payload` serves without") from error
    return np.ndarray(shape, form.dtype, buffer=payload)
