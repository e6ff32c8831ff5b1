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

import struct
from collections.abc import Sequence
from typing import Any, final

from eal_actors.device.data.forms import (
    BOOL,
    DOUBLE,
    INT,
    SHOWN_BYTES,
    SHOWN_ELEMENTS,
    TEXT,
    DataType,
    Form,
    find_form,
    int_form,
    shown,
)
from eal_actors.device.data.storage import (
    Payload,
    Stored,
    as_array,
    as_bytes,
    checked_meta,
    checked_shape,
    infer,
    read,
    store,
    unpack,
)
from eal_actors.kernel.errors import DataError


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
    _form: Form
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
        form = find_form(type, is_ptr, is_unsigned, is_short, is_long)
        self._fill(form, store(form, value, length), unit, frame_id, stamp_s)

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
            form = DOUBLE
        elif kind is int:
            form = INT if -0x80000000 <= value <= 0x7FFFFFFF else int_form(value, value, is_ptr=False)
        elif kind is bool:
            form = BOOL
        elif kind is EALData:
            return value.with_meta(unit=unit, frame_id=frame_id, stamp_s=stamp_s)  # type: ignore[no-any-return]
        else:
            form, value = infer(value)
            self = cls.__new__(cls)
            return self._fill(form, store(form, value, None), unit, frame_id, stamp_s)
        self = cls.__new__(cls)
        return self._fill(form, (value, None, form.width, None), unit, frame_id, stamp_s)

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

        Takes the arguments of the constructor; `payload` holds contiguous little-endian bytes. A numpy array has a
        `shape`, row-major, and a `dtype` such as `<f4`; numpy itself is needed only to read its `value`. Arrays stay
        in the buffer, which must not change any more.

        Raises:
            DataError: the bytes are no value of that type and shape.
        """
        form = find_form(type, is_ptr, is_unsigned, is_short, is_long)
        view = as_bytes(payload)
        if form.type is DataType.BOOL and bytes(view).strip(b"\0\1"):
            raise DataError("payload: a bool is 0 or 1, other bytes have no meaning")
        if shape is None and dtype is None:
            stored = read(form, view)
        else:
            stored = None, view, len(view), checked_shape(form, len(view), shape, dtype)
        self = cls.__new__(cls)
        return self._fill(form, stored, unit, frame_id, stamp_s)

    def with_meta(
        self, *, unit: str | None = None, frame_id: str | None = None, stamp_s: float | None = None
    ) -> EALData:
        """Return the same value with another unit, frame or time; None leaves what is there.

        Raises:
            DataError: see EALData.
        """
        if unit is None and frame_id is None and stamp_s is None:
            return self
        copy = EALData.__new__(EALData)
        return EALData._fill(
            copy,
            self._form,
            (self._value, self._payload, self._length, self._shape),
            self._unit if unit is None else unit,
            self._frame_id if frame_id is None else frame_id,
            self._stamp_s if stamp_s is None else stamp_s,
        )

    def _fill(
        self, form: Form, stored: Stored, unit: str | None, frame_id: str | None, stamp_s: float | None
    ) -> EALData:
        if unit is not None or frame_id is not None or stamp_s is not None:
            stamp_s = checked_meta(unit, frame_id, stamp_s)
        self._form = form
        self._value, self._payload, self._length, self._shape = stored
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
            value = self._value = as_array(payload, self._shape, self._form)
            return value
        if self._form.type is DataType.VOID:
            value = self._value = bytes(payload)
            return value
        return unpack(self._form, payload)

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
        form = self._form
        if self._shape is not None:
            content = f" shape={self._shape}"
        elif not form.is_ptr or form == TEXT:
            content = f" {shown(self._value)}"
        elif form.type is DataType.VOID:
            content = f" {shown(bytes(self.payload[: SHOWN_BYTES + 1]))}"
        else:
            content = f" {shown(unpack(form, self.payload[: (SHOWN_ELEMENTS + 1) * form.width]))}"
        size = f"[{self._length // form.width}]" if form.is_ptr else ""
        meta = {"unit": self._unit, "frame_id": self._frame_id, "stamp_s": self._stamp_s}
        notes = "".join(f", {name}={shown(note)}" for name, note in meta.items() if note is not None)
        return f"EALData({form.name}{size}{content}{notes})"
