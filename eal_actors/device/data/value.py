"""EALData: the one kind of value that crosses the framework.

A value is typed and laid out as in C, with the widths of a 64-bit Linux compiler (LP64), little-endian on every host:
char 1, bool 1, short 2, int 4, float 4, long 8, double 8 bytes; void is any number of bytes. Choices that C leaves
open:

- A plain char is text. Its sign differs between x86-64 and ARM, so numbers over 127 go into an unsigned char.
- A char array is UTF-8. `length` counts bytes, not characters; the rest of the array is zero, the text ends at the
  first zero byte, and a text that fills its array has no zero byte at the end.
- A pointer is an array, even of one element: the address itself means nothing on another machine.
- The elements of a list determine its element type, so an empty list becomes a void array of length 0 (`b""`).
- A float (32 bits) reads back as it was rounded, the same at both ends of a network.

Source: thesis §4.6, B.1.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import Any, Final, NoReturn, final

from eal_actors.device.data.c_types import (
    ARRAY_BY_DTYPE,
    BOOL,
    DOUBLE,
    INT,
    SHOWN_BYTES,
    SHOWN_ELEMENTS,
    TEXT,
    CType,
    DataType,
    find_c_type,
    int_c_type,
    short_repr,
)
from eal_actors.device.data.pictures import is_picture, picture_png
from eal_actors.device.data.storage import (
    PLAIN_NUMBERS,
    Payload,
    Stored,
    as_array,
    as_bytes,
    checked_shape,
    infer,
    pack,
    read,
    store,
    unpack,
)
from eal_actors.kernel.errors import DataError

_MAX_S: Final = sys.float_info.max

SHOWN_NUMBERS: Final = 16
"""Arrays with at most so many numbers are shown as numbers, such as a pose; others by their shape."""


@final
class EALData:
    """An immutable value with its C type, unit, frame and time.

    Everything is checked at construction; bytes are made when they are needed. Two are equal if their descriptions and
    bytes are: a NaN equals itself, 0.0 differs from -0.0. Not hashable, because it may hold a numpy array. Neither true
    nor false, nor compared with a number or text, because `if eal.get_value(bump):` means the `value`.

    Args:
        value: int, float, bool, str, bytes, a list or tuple of numbers, or a numpy array; None for VOID alone. The
            framework reads an array in place: the caller must not change it afterwards.
        length: bytes, as `sizeof` counts them; None for what the value needs. Over what it needs only for text.
        is_ptr: an array.
        is_unsigned: for INT and CHAR.
        is_short, is_long: for INT.
        unit: unit of the value, such as `m` or `rad/s`.
        frame_id: name of the coordinate frame the value is given in.
        stamp_s: the time of the value, in seconds of the fleet's clock.

    Raises DataError if the modifiers contradict each other, or the value or length does not fit the type. Thread: any.
    Source: thesis B.1.2; unlike there, modifiers cannot be set afterwards, because other threads read the same object.
    """

    __slots__ = ("_c_type", "_frame_id", "_length", "_payload", "_shape", "_stamp_s", "_unit", "_value")

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
        c_type = find_c_type(type, is_ptr, is_unsigned, is_short, is_long)
        self._fill(c_type, store(c_type, value, length), unit, frame_id, stamp_s)

    @classmethod
    def of(
        cls, value: Any, *, unit: str | None = None, frame_id: str | None = None, stamp_s: float | None = None
    ) -> EALData:
        """Wrap a Python value in the type that fits it.

        `value` is a bool, an int (long or unsigned long where int is too small), a float (DOUBLE), a str, bytes, a list
        or tuple of bools or of numbers, a numpy scalar or array, None, an EALData, which is returned as it is, or an
        object whose method `__eal_data__` returns one. `unit`, `frame_id` and `stamp_s` are as for EALData; None keeps
        those of an EALData. Raises DataError if no type fits the value.
        """
        kind, self = type(value), cls.__new__(cls)
        if kind is float:
            c_type = DOUBLE
        elif kind is int:
            c_type = INT if -0x80000000 <= value <= 0x7FFFFFFF else int_c_type(value, value, is_ptr=False)
        elif kind is bool:
            c_type = BOOL
        elif kind is EALData:
            return value.with_meta(unit=unit, frame_id=frame_id, stamp_s=stamp_s)  # type: ignore[no-any-return]
        elif (array := _array_content(value)) is not None:
            return self._fill(*array, unit, frame_id, stamp_s)
        elif (convert := getattr(kind, "__eal_data__", None)) is not None:
            return cls.of(convert(value), unit=unit, frame_id=frame_id, stamp_s=stamp_s)
        else:
            c_type, value = infer(value)
            return self._fill(c_type, store(c_type, value, None), unit, frame_id, stamp_s)
        return self._fill(c_type, (value, None, c_type.width, None), unit, frame_id, stamp_s)

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
        """Rebuild an EALData from its bytes, from a network or a record.

        Takes the arguments of the constructor; `payload` holds contiguous little-endian bytes. A numpy array has a
        `shape`, row-major, and a `dtype` such as `<f4`; numpy itself is needed only to read its `value`. Arrays stay in
        the buffer, which must not change afterwards. Raises DataError if the bytes are no value of that type and shape.
        """
        c_type = find_c_type(type, is_ptr, is_unsigned, is_short, is_long)
        return cls.from_c_type(c_type, payload, shape, dtype, unit=unit, frame_id=frame_id, stamp_s=stamp_s)

    @classmethod
    def from_c_type(
        cls,
        c_type: CType,
        payload: bytes | bytearray | memoryview,
        shape: Sequence[int] | None = None,
        dtype: str | None = None,
        *,
        unit: str | None = None,
        frame_id: str | None = None,
        stamp_s: float | None = None,
    ) -> EALData:
        """Rebuild an EALData from its bytes like `from_payload`, with its type from the table; raises the same."""
        self = cls.__new__(cls)
        number = PLAIN_NUMBERS.get(c_type.full_name) if shape is None and dtype is None else None
        if number is not None and type(payload) is bytes and len(payload) == c_type.width:  # the most frequent values
            return self._fill(c_type, (number(payload)[0], payload, c_type.width, None), unit, frame_id, stamp_s)
        view = payload if type(payload) is bytes else as_bytes(payload)
        if c_type.code == "?" and bytes(view).strip(b"\0\1"):
            raise DataError("payload: a bool is 0 or 1, other bytes have no meaning")
        if shape is None and dtype is None:
            stored = read(c_type, view)
        else:
            stored = None, view, len(view), checked_shape(c_type, len(view), shape, dtype)
        return self._fill(c_type, stored, unit, frame_id, stamp_s)

    def with_meta(
        self, *, unit: str | None = None, frame_id: str | None = None, stamp_s: float | None = None
    ) -> EALData:
        """Return the same value with another unit, frame or time; None keeps the present one.

        Raises DataError as EALData does.
        """
        if unit is None and frame_id is None and stamp_s is None:
            return self
        return EALData._fill(
            EALData.__new__(EALData),
            self._c_type,
            (self._value, self._payload, self._length, self._shape),
            self._unit if unit is None else unit,
            self._frame_id if frame_id is None else frame_id,
            self._stamp_s if stamp_s is None else stamp_s,
        )

    def restamp(self, stamp_s: float | None) -> None:
        """Set the time of a value that nobody else has yet; for decoders."""
        self._stamp_s = stamp_s

    def _fill(
        self, c_type: CType, stored: Stored, unit: str | None, frame_id: str | None, stamp_s: float | None
    ) -> EALData:
        if unit is not None or frame_id is not None:
            stamp_s = _checked_meta(unit, frame_id, stamp_s)
        elif stamp_s is not None and not (type(stamp_s) is float and -_MAX_S <= stamp_s <= _MAX_S):
            stamp_s = _checked_meta(None, None, stamp_s)
        self._c_type = c_type
        self._value, self._payload, self._length, self._shape = stored
        self._unit = unit
        self._frame_id = frame_id
        self._stamp_s = stamp_s
        return self

    @property
    def c_type(self) -> CType:
        """The C type, with its modifiers."""
        return self._c_type

    @property
    def type(self) -> DataType:
        """The base type."""
        return self._c_type.type

    @property
    def is_ptr(self) -> bool:
        """True for arrays: text, bytes, lists and numpy arrays."""
        return self._c_type.is_ptr

    @property
    def is_unsigned(self) -> bool:
        """True for `unsigned`."""
        return self._c_type.is_unsigned

    @property
    def is_short(self) -> bool:
        """True for `short`."""
        return self._c_type.is_short

    @property
    def is_long(self) -> bool:
        """True for `long`."""
        return self._c_type.is_long

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
        """The time of the value, in seconds of the fleet's clock."""
        return self._stamp_s

    @property
    def shape(self) -> tuple[int, ...] | None:
        """Shape of a numpy array, None for everything else."""
        return self._shape

    @property
    def dtype(self) -> str | None:
        """Dtype of a numpy array, such as `<f4` or `|u1`, None for everything else."""
        return None if self._shape is None else self._c_type.dtype

    @property
    def value(self) -> Any:
        """The Python value.

        int, float or bool; str for char and text; bytes for VOID; a new list for an array of numbers; a read-only numpy
        array, not copied, for a numpy array; None for an empty VOID. Raises DataError if a numpy array came over the
        network and numpy is not installed; `payload` serves without.
        """
        if self._value is not None or not self._c_type.is_ptr:
            return self._value
        payload = self.payload
        if self._shape is not None:
            self._value = as_array(payload, self._shape, self._c_type)
        elif self._c_type.type is DataType.VOID:
            self._value = bytes(payload)
        else:
            return unpack(self._c_type, payload)
        return self._value

    @property
    def payload(self) -> Payload:
        """The bytes as C lays them out, little-endian; a view without a copy for a contiguous numpy array."""
        if self._payload is None:
            self._payload = pack(self._c_type, self._value, self._length, self._shape)
        return self._payload

    def __eq__(self, other: object) -> bool:
        if isinstance(other, int | float | str):
            raise TypeError(f"{self!r} is never equal to {other!r}; its `value` may be")
        if not isinstance(other, EALData):
            return NotImplemented
        return self.description == other.description and self.payload == other.payload

    def __bool__(self) -> NoReturn:
        raise TypeError(f"{self!r} is neither true nor false; its `value` may be")

    __hash__ = None  # type: ignore[assignment]

    @property
    def description(self) -> tuple[CType, int, tuple[int, ...] | None, str | None, str | None, float | None]:
        """C type, length, shape, unit, frame and time."""
        return self._c_type, self._length, self._shape, self._unit, self._frame_id, self._stamp_s

    def __repr__(self) -> str:
        return data_text(self)

    def _repr_png_(self) -> bytes | None:
        """Return a picture as PNG, which notebooks show; None for other values."""
        return picture_png(self.payload, self._shape) if is_picture(self._c_type, self._shape) else None


def _array_content(value: Any) -> tuple[CType, Stored] | None:
    """Return the C type and content of a numpy array; None for anything else. Does not import numpy."""
    array_type = getattr(sys.modules.get("numpy"), "ndarray", None)  # another thread may be importing numpy right now
    if array_type is None or type(value) is not array_type:  # subclasses are for `infer`
        return None
    if (c_type := ARRAY_BY_DTYPE.get(value.dtype.str)) is None:  # `infer` refuses it with a message
        return None
    view = value.view()
    view.flags.writeable = False
    return c_type, (view, None, view.nbytes, view.shape)


def _checked_meta(unit: object, frame_id: object, stamp_s: object) -> float | None:
    """Return the time stamp as a float, or raise DataError for an invalid unit, frame or time stamp."""
    if unit is not None and not isinstance(unit, str):
        raise DataError(f"unit: {short_repr(unit)} is no str")
    if frame_id is not None and not isinstance(frame_id, str):
        raise DataError(f"frame_id: {short_repr(frame_id)} is no str")
    if stamp_s is None:
        return None
    if isinstance(stamp_s, bool) or not isinstance(stamp_s, (int, float)) or not -_MAX_S <= stamp_s <= _MAX_S:
        raise DataError(f"stamp_s: {short_repr(stamp_s)} is no finite number of seconds")
    return float(stamp_s)


def data_text(data: EALData) -> str:
    """Return a value with its type, length and notes, such as `EALData(double 0.5, unit='m')`."""
    c_type = data.c_type
    size = f"[{data.length // c_type.width}]" if c_type.is_ptr else ""
    meta = {"unit": data.unit, "frame_id": data.frame_id, "stamp_s": data.stamp_s}
    notes = "".join(f", {name}={short_repr(note)}" for name, note in meta.items() if note is not None)
    return f"EALData({c_type.name}{size} {_content_text(data)}{notes})"


def _content_text(data: EALData) -> str:
    """Return the content of a value, short even for a large one."""
    c_type = data.c_type
    if data.shape is not None:
        is_short = math.prod(data.shape) <= SHOWN_NUMBERS
        return _rounded(data.value.tolist()) if is_short else f"shape={data.shape}"
    if not c_type.is_ptr or c_type == TEXT:
        return short_repr(data.value)
    if c_type.type is DataType.VOID:
        return short_repr(bytes(data.payload[: SHOWN_BYTES + 1]))
    return short_repr(unpack(c_type, data.payload[: (SHOWN_ELEMENTS + 1) * c_type.width]))


def _rounded(value: Any) -> str:
    """Return a list of numbers as text, with six digits."""
    if isinstance(value, list):
        return f"[{', '.join(map(_rounded, value))}]"
    return f"{value:.6g}" if isinstance(value, float) else repr(value)
