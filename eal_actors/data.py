"""EALData: the one kind of value that crosses the framework, typed and laid out as in C.

Widths are those of a 64-bit Linux compiler (LP64), little-endian whatever the host: char 1, bool 1, short 2, int 4,
float 4, long 8, double 8 bytes; void is any number of bytes. Choices that C leaves open:

- A plain char is text. Its sign differs between x86-64 and ARM, so numbers over 127 go into an unsigned char.
- A char array is UTF-8. `length` counts bytes, not characters; what the text does not fill is zero, the text ends at
  the first zero byte, and a text that fills its array has no zero byte at the end.
- A pointer is an array, even of one element: the address itself means nothing on another machine.
- A list names its element type by its elements, so an empty one becomes a void array of length 0 (`b""`).
- A float (32 bits) reads back as it was rounded, the same at both ends of a network.

Source: thesis §4.6, B.1.
"""

from __future__ import annotations

import enum
import math
import reprlib
import struct
import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self, final

from eal_actors.errors import DataError

if TYPE_CHECKING:
    import numpy as np

Payload = bytes | memoryview


class DataType(enum.Enum):
    """The base types (Source: thesis B.1.1)."""

    INT = "int"
    CHAR = "char"
    FLOAT = "float"
    DOUBLE = "double"
    BOOL = "bool"
    VOID = "void"


class _Form(NamedTuple):
    """A C type, plain or as an array: what all EALData of that type share."""

    type: DataType
    is_ptr: bool
    is_unsigned: bool
    is_short: bool
    is_long: bool
    name: str  # of one element, as C writes it
    code: str  # of one element, as `struct` writes it
    width: int  # bytes of one element; 0 for a void that is no array
    takes: str  # what one element may be, for messages
    dtype: str | None  # the numpy dtype of an array, None where numpy arrays are not taken


class _Stored(NamedTuple):
    """What an EALData keeps of a value: `value` or `payload` is None until it is asked for."""

    value: Any
    payload: Payload | None
    length: int
    shape: tuple[int, ...] | None = None


_UNSIGNED, _SHORT, _LONG = (True, False, False), (False, True, False), (False, False, True)
_UNSIGNED_SHORT, _UNSIGNED_LONG, _PLAIN = (True, True, False), (True, False, True), (False, False, False)
_C_TYPES: Final = (
    (DataType.INT, _PLAIN, "int", "i", f"an int in {-(2**31)}..{2**31 - 1}", "<i4"),
    (DataType.INT, _UNSIGNED, "unsigned int", "I", f"an int in 0..{2**32 - 1}", None),
    (DataType.INT, _SHORT, "short", "h", f"an int in {-(2**15)}..{2**15 - 1}", "<i2"),
    (DataType.INT, _UNSIGNED_SHORT, "unsigned short", "H", f"an int in 0..{2**16 - 1}", None),
    (DataType.INT, _LONG, "long", "q", f"an int in {-(2**63)}..{2**63 - 1}", "<i8"),
    (DataType.INT, _UNSIGNED_LONG, "unsigned long", "Q", f"an int in 0..{2**64 - 1}", None),
    (DataType.CHAR, _PLAIN, "char", "c", "one ASCII character or its code, an int in 0..127", None),
    (DataType.CHAR, _UNSIGNED, "unsigned char", "B", "an int in 0..255", "|u1"),
    (DataType.FLOAT, _PLAIN, "float", "f", "a float or int up to 3.4e38", "<f4"),
    (DataType.DOUBLE, _PLAIN, "double", "d", "a float or int up to 1.7e308", "<f8"),
    (DataType.BOOL, _PLAIN, "bool", "?", "True or False", "|b1"),
    (DataType.VOID, _PLAIN, "void", "s", "None", None),
)
_FORMS: Final = {
    (kind, is_ptr, *modifiers): _Form(
        kind, is_ptr, *modifiers, name, code, struct.calcsize(f"<{code}") if name != "void" or is_ptr else 0, takes, dtype
    )
    for kind, modifiers, name, code, takes, dtype in _C_TYPES
    for is_ptr in (False, True)
}
_ARRAY_BY_DTYPE: Final = {form.dtype: form for form in _FORMS.values() if form.dtype and form.is_ptr}
_SCALAR_BY_DTYPE: Final = {form.dtype: form for form in _FORMS.values() if form.dtype and not form.is_ptr}
_INTS: Final = {
    is_ptr: [_FORMS[DataType.INT, is_ptr, *modifiers] for modifiers in (_PLAIN, _LONG, _UNSIGNED_LONG)]
    for is_ptr in (False, True)
}
_INT: Final = _FORMS[DataType.INT, False, *_PLAIN]
_DOUBLE: Final = _FORMS[DataType.DOUBLE, False, *_PLAIN]
_BOOL: Final = _FORMS[DataType.BOOL, False, *_PLAIN]
_VOID: Final = _FORMS[DataType.VOID, False, *_PLAIN]
_TEXT: Final = _FORMS[DataType.CHAR, True, *_PLAIN]
_BYTES: Final = _FORMS[DataType.VOID, True, *_PLAIN]

_ELEMENTS: Final[dict[DataType, tuple[type, ...]]] = {
    DataType.INT: (int,),
    DataType.CHAR: (int,),
    DataType.FLOAT: (float, int),
    DataType.DOUBLE: (float, int),
    DataType.BOOL: (bool,),
}
_MOST_DIMENSIONS: Final = 32  # of numpy 1.26
_SHOWN_ELEMENTS: Final = 6
_SHOWN_BYTES: Final = 24


@final
class EALData:
    """An immutable value with its C type, unit, frame and time.

    Everything is checked when it is made; bytes are made when they are asked for. Equal means the same description
    and the same bytes: a NaN equals itself, 0.0 differs from -0.0. Not hashable, since it may hold a numpy array.

    Args:
        type: the base type.
        value: int, float, bool, str, bytes, a list or tuple of numbers, or a numpy array; None for VOID alone. The
            framework reads an array in place: whoever hands it over must not change it any more.
        length: bytes, as `sizeof` counts them; None for what the value needs. Over what it needs only for text.
        is_ptr: an array.
        is_unsigned: for INT and CHAR.
        is_short: for INT.
        is_long: for INT.
        unit: unit of the value, such as `m` or `rad/s`.
        frame_id: name of the coordinate frame the value is given in.
        stamp_s: when the value was true, in seconds of the fleet's clock.

    Raises:
        DataError: the modifiers contradict each other, or the value or length does not fit the type.

    Departs from §B.1.2.2: modifiers cannot be set afterwards, as other threads read the same object.
    Thread: any.
    Source: thesis B.1.2.
    """

    __slots__ = ("_form", "_frame_id", "_length", "_payload", "_shape", "_stamp_s", "_unit", "_value")
    _form: _Form
    _value: Any
    _payload: Payload | None
    _length: int
    _shape: tuple[int, ...] | None
    _unit: str | None
    _frame_id: str | None
    _stamp_s: float | None

    def __init__(
        self,
        type: DataType = DataType.INT,  # noqa: A002
        value: object = None,
        length: int | None = None,
        *,
        is_ptr: bool = False,
        is_unsigned: bool = False,
        is_short: bool = False,
        is_long: bool = False,
        unit: str | None = None,
        frame_id: str | None = None,
        stamp_s: float | None = None,
    ) -> None:
        form = _find_form(type, is_ptr, is_unsigned, is_short, is_long)
        self._fill(form, *_store(form, value, length), unit, frame_id, stamp_s)

    @classmethod
    def of(
        cls, value: Any, *, unit: str | None = None, frame_id: str | None = None, stamp_s: float | None = None
    ) -> EALData:
        """Wrap a Python value in the type that fits it.

        Args:
            value: bool, int (long or unsigned long where int is too small), float (DOUBLE), str, bytes, a list or
                tuple of bools or of numbers, a numpy scalar or array, None, or an EALData, which is returned as it is.
            unit: see EALData; None leaves the unit of an EALData.
            frame_id: likewise.
            stamp_s: likewise.

        Raises:
            DataError: no type fits the value.
        """
        kind = type(value)
        if kind is float:
            form = _DOUBLE
        elif kind is int:
            form = _INT if -0x80000000 <= value <= 0x7FFFFFFF else _int_form(value, value, is_ptr=False)
        elif kind is bool:
            form = _BOOL
        elif kind is EALData:
            return value.with_meta(unit=unit, frame_id=frame_id, stamp_s=stamp_s)  # type: ignore[no-any-return]
        else:
            form, value = _infer(value)
            return _new(cls)._fill(form, *_store(form, value, None), unit, frame_id, stamp_s)
        return _new(cls)._fill(form, value, None, form.width, None, unit, frame_id, stamp_s)

    @classmethod
    def from_payload(
        cls,
        type: DataType,  # noqa: A002
        payload: bytes | bytearray | memoryview,
        *,
        is_ptr: bool = False,
        is_unsigned: bool = False,
        is_short: bool = False,
        is_long: bool = False,
        shape: Sequence[int] | None = None,
        dtype: str | None = None,
        unit: str | None = None,
        frame_id: str | None = None,
        stamp_s: float | None = None,
    ) -> EALData:
        """Rebuild an EALData from its bytes, as they came over a network or out of a record.

        Arrays stay in the buffer, which must not change any more. numpy is needed only to read `value`.

        Args:
            type: the base type.
            payload: contiguous little-endian bytes.
            is_ptr: see EALData, as for all modifiers and `unit`, `frame_id` and `stamp_s`.
            is_unsigned: see EALData.
            is_short: see EALData.
            is_long: see EALData.
            shape: of a numpy array, together with `dtype`; row-major.
            dtype: of a numpy array, such as `<f4`.
            unit: see EALData.
            frame_id: see EALData.
            stamp_s: see EALData.

        Raises:
            DataError: the bytes are no value of that type and shape.
        """
        form = _find_form(type, is_ptr, is_unsigned, is_short, is_long)
        view = _as_bytes(payload)
        if shape is None and dtype is None:
            stored = _read(form, view)
        else:
            stored = _Stored(None, view, len(view), _checked_shape(form, len(view), shape, dtype))
        return _new(cls)._fill(form, *stored, unit, frame_id, stamp_s)

    def with_meta(
        self, *, unit: str | None = None, frame_id: str | None = None, stamp_s: float | None = None
    ) -> EALData:
        """Return the same value with another unit, frame or time; None leaves what is there.

        Raises:
            DataError: see EALData.
        """
        if unit is None and frame_id is None and stamp_s is None:
            return self
        return _new(EALData)._fill(
            self._form,
            self._value,
            self._payload,
            self._length,
            self._shape,
            self._unit if unit is None else unit,
            self._frame_id if frame_id is None else frame_id,
            self._stamp_s if stamp_s is None else stamp_s,
        )

    def _fill(
        self,
        form: _Form,
        value: Any,
        payload: Payload | None,
        length: int,
        shape: tuple[int, ...] | None,
        unit: str | None,
        frame_id: str | None,
        stamp_s: float | None,
    ) -> Self:
        if unit is not None or frame_id is not None or stamp_s is not None:
            stamp_s = _checked_meta(unit, frame_id, stamp_s)
        self._form = form
        self._value = value
        self._payload = payload
        self._length = length
        self._shape = shape
        self._unit = unit
        self._frame_id = frame_id
        self._stamp_s = stamp_s
        return self

    @property
    def type(self) -> DataType:
        """The base type."""
        return self._form.type

    @property
    def is_ptr(self) -> bool:
        """True for arrays: text, bytes, lists and numpy arrays."""
        return self._form.is_ptr

    @property
    def is_unsigned(self) -> bool:
        """True for `unsigned`."""
        return self._form.is_unsigned

    @property
    def is_short(self) -> bool:
        """True for `short`."""
        return self._form.is_short

    @property
    def is_long(self) -> bool:
        """True for `long`."""
        return self._form.is_long

    @property
    def length(self) -> int:
        """Bytes of the payload."""
        return self._length

    @property
    def unit(self) -> str | None:
        """Unit of the value."""
        return self._unit

    @property
    def frame_id(self) -> str | None:
        """Name of the coordinate frame the value is given in."""
        return self._frame_id

    @property
    def stamp_s(self) -> float | None:
        """When the value was true, in seconds of the fleet's clock."""
        return self._stamp_s

    @property
    def shape(self) -> tuple[int, ...] | None:
        """Shape of a numpy array, None for everything else."""
        return self._shape

    @property
    def dtype(self) -> str | None:
        """Dtype of a numpy array, such as `<f4` or `|u1`, None for everything else."""
        return None if self._shape is None else self._form.dtype

    @property
    def value(self) -> Any:
        """The Python value.

        int, float or bool; str for char and text; bytes for VOID; a new list for an array of numbers; a read-only
        numpy array, not copied, for what was a numpy array; None for an empty VOID.

        Raises:
            DataError: a numpy array came over the network and numpy is not installed; `payload` serves without.
        """
        value = self._value
        if value is not None or not self._form.is_ptr:
            return value
        payload = self.payload
        if self._shape is not None:
            value = self._value = _as_array(payload, self._shape, self._form)
            return value
        if self._form.type is DataType.VOID:
            value = self._value = bytes(payload)
            return value
        return _unpack(self._form, payload)

    @property
    def payload(self) -> Payload:
        """The bytes as C lays them out, little-endian; a view without a copy for a contiguous numpy array."""
        payload = self._payload
        if payload is None:
            payload = self._payload = self._pack()
        return payload

    def _pack(self) -> Payload:
        value = self._value
        if value is None:
            return b""
        if isinstance(value, str):
            return value.encode().ljust(self._length, b"\0")
        if self._shape is not None:
            return memoryview(value.reshape(-1).view("u1"))
        return struct.pack(f"<{self._form.code}", value)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, EALData):
            return NotImplemented
        return self._description() == other._description() and self.payload == other.payload

    __hash__ = None  # type: ignore[assignment]

    def _description(self) -> tuple[object, ...]:
        return self._form, self._length, self._shape, self._unit, self._frame_id, self._stamp_s

    def __repr__(self) -> str:
        form, size = self._form, ""
        if form.is_ptr:
            size = f"[{self._length // form.width}]"
        if self._shape is not None:
            shown = f" shape={self._shape}"
        elif not form.is_ptr or form == _TEXT:
            shown = "" if self._value is None else f" {reprlib.repr(self._value)}"
        else:
            shown = f" {_beginning(form, self.payload)}"
        meta = {"unit": self._unit, "frame_id": self._frame_id, "stamp_s": self._stamp_s}
        notes = "".join(f", {name}={reprlib.repr(note)}" for name, note in meta.items() if note is not None)
        return f"EALData({form.name}{size}{shown}{notes})"


_new: Final = object.__new__
