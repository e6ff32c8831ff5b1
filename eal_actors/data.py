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
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple, final

from eal_actors.errors import DataError

if TYPE_CHECKING:
    import numpy as np

Payload = bytes | memoryview
_Stored = tuple[Any, Payload | None, int, tuple[int, ...] | None]
"""What an EALData keeps: value, payload, length and shape; value or payload may be None until it is asked for."""


class DataType(enum.Enum):
    """The base types (Source: thesis B.1.1)."""

    INT = "int"
    CHAR = "char"
    FLOAT = "float"
    DOUBLE = "double"
    BOOL = "bool"
    VOID = "void"

    __hash__ = object.__hash__  # by identity: several times faster than by name


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
        kind,
        is_ptr,
        *modifiers,
        name,
        code,
        struct.calcsize(f"<{code}") if name != "void" or is_ptr else 0,
        takes,
        dtype,
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

_NUMBERS: Final[dict[DataType, tuple[type, ...]]] = {
    DataType.INT: (int,),
    DataType.CHAR: (int,),
    DataType.FLOAT: (float, int),
    DataType.DOUBLE: (float, int),
}
_BUILTINS: Final = frozenset({int, float, bool, str, bytes, bytearray, memoryview, list, tuple, type(None)})
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
        self._fill(form, _store(form, value, length), unit, frame_id, stamp_s)

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
            self = cls.__new__(cls)
            return self._fill(form, _store(form, value, None), unit, frame_id, stamp_s)
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
        form = _find_form(type, is_ptr, is_unsigned, is_short, is_long)
        view = _as_bytes(payload)
        if form.type is DataType.BOOL and bytes(view).strip(b"\0\1"):
            raise DataError("payload: a bool is 0 or 1, other bytes have no meaning")
        if shape is None and dtype is None:
            stored = _read(form, view)
        else:
            stored = None, view, len(view), _checked_shape(form, len(view), shape, dtype)
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
        self, form: _Form, stored: _Stored, unit: str | None, frame_id: str | None, stamp_s: float | None
    ) -> EALData:
        if unit is not None or frame_id is not None or stamp_s is not None:
            stamp_s = _checked_meta(unit, frame_id, stamp_s)
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
        form = self._form
        if self._shape is not None:
            shown = f" shape={self._shape}"
        elif not form.is_ptr or form == _TEXT:
            shown = f" {_shown(self._value)}"
        elif form.type is DataType.VOID:
            shown = f" {_shown(bytes(self.payload[: _SHOWN_BYTES + 1]))}"
        else:
            shown = f" {_shown(_unpack(form, self.payload[: (_SHOWN_ELEMENTS + 1) * form.width]))}"
        size = f"[{self._length // form.width}]" if form.is_ptr else ""
        meta = {"unit": self._unit, "frame_id": self._frame_id, "stamp_s": self._stamp_s}
        notes = "".join(f", {name}={_shown(note)}" for name, note in meta.items() if note is not None)
        return f"EALData({form.name}{size}{shown}{notes})"


def _find_form(kind: DataType, is_ptr: bool, is_unsigned: bool, is_short: bool, is_long: bool) -> _Form:
    try:
        return _FORMS[kind, is_ptr, is_unsigned, is_short, is_long]
    except (KeyError, TypeError):
        pass
    if not isinstance(kind, DataType):
        raise DataError(f"type: {_shown(kind)} is no DataType; there are {', '.join(DataType.__members__)}")
    flags = {"is_ptr": is_ptr, "is_unsigned": is_unsigned, "is_short": is_short, "is_long": is_long}
    for name, flag in flags.items():
        if not isinstance(flag, bool):
            raise DataError(f"{name}: {_shown(flag)} is no bool")
    given = "".join(f"{name[3:]} " for name in list(flags)[1:] if flags[name])
    allowed = ", ".join(form.name for form in _FORMS.values() if form.type is kind and not form.is_ptr)
    why = "; long double has no size common to all machines" if kind is DataType.DOUBLE and is_long else ""
    raise DataError(f"there is no {given}{kind.value} here, only {allowed}{why}")


def _checked_meta(unit: object, frame_id: object, stamp_s: object) -> float | None:
    for name, text in (("unit", unit), ("frame_id", frame_id)):
        if text is not None and not isinstance(text, str):
            raise DataError(f"{name}: {_shown(text)} is no str")
    if stamp_s is None:
        return None
    if isinstance(stamp_s, bool) or not isinstance(stamp_s, (int, float)) or not abs(stamp_s) <= sys.float_info.max:
        raise DataError(f"stamp_s: {_shown(stamp_s)} is no finite number of seconds")
    return float(stamp_s)


def _int_form(low: int, high: int, *, is_ptr: bool) -> _Form:
    plain, long, unsigned_long = _INTS[is_ptr]
    if low >= -(2**31) and high < 2**31:
        return plain
    if low >= -(2**63) and high < 2**63:
        return long
    if low >= 0 and high < 2**64:
        return unsigned_long
    culprit = _shown(low) if low == high else f"a list from {_shown(low)} to {_shown(high)}"
    raise DataError(f"{culprit} fits neither long, {-(2**63)}..{2**63 - 1}, nor unsigned long, 0..{2**64 - 1}")


def _infer(value: Any) -> tuple[_Form, Any]:
    """Choose the form for a value that is no plain int, float or bool."""
    is_array = _is_numpy(value, "ndarray")
    if is_array or _is_numpy(value, "generic"):
        form = (_ARRAY_BY_DTYPE if is_array else _SCALAR_BY_DTYPE).get(value.dtype.str)
        if form is None:
            raise DataError(f"numpy dtype {value.dtype.str} has no type here, only {', '.join(_ARRAY_BY_DTYPE)}")
        return form, value
    if value is None:
        return _VOID, None
    if isinstance(value, str):
        return _TEXT, value
    if isinstance(value, (bytes, bytearray, memoryview)):
        return _BYTES, value
    if isinstance(value, (list, tuple)):
        return _infer_list(value)
    if isinstance(value, int):
        return _int_form(int(value), int(value), is_ptr=False), value
    if isinstance(value, float):
        return _DOUBLE, value
    raise DataError(
        f"no type fits {_shown(value)}, a {type(value).__name__}; "
        "there are types for bool, int, float, str, bytes, None, lists of numbers and numpy arrays"
    )


def _infer_list(values: Sequence[Any]) -> tuple[_Form, Sequence[Any]]:
    if not values:
        return _BYTES, b""
    values = _without_numpy(values)
    kinds = set(map(type, values))
    if kinds == {bool}:
        return _FORMS[DataType.BOOL, True, *_PLAIN], values
    if bool not in kinds and all(issubclass(kind, int) for kind in kinds):
        return _int_form(min(values), max(values), is_ptr=True), values
    if bool not in kinds and all(issubclass(kind, (int, float)) for kind in kinds):
        return _FORMS[DataType.DOUBLE, True, *_PLAIN], values
    names = ", ".join(sorted(kind.__name__ for kind in kinds))
    raise DataError(f"a list of {names} has no type; all elements must be bools, or all must be ints and floats")


def _store(form: _Form, value: Any, length: int | None) -> _Stored:
    """Check a value against its form and its length, and return what an EALData keeps of it."""
    if length is not None and (type(length) is not int or length < 0):
        raise DataError(f"length: {_shown(length)} is no number of bytes")
    if form == _TEXT:
        return _store_text(value, length)
    if _is_numpy(value, "ndarray"):
        stored = _store_array(form, value)
    elif not form.is_ptr:
        stored = _store_scalar(form, value)
    else:
        stored = _store_sequence(form, value)
    needed = stored[2]
    if length is not None and length != needed:
        hint = "; is_long=True makes an int 8 bytes" if form == _INT and length == 8 else ""
        raise DataError(f"length: this {form.name}{'[]' * form.is_ptr} takes {needed} bytes, not {length}{hint}")
    return stored


def _store_sequence(form: _Form, value: Any) -> _Stored:
    if form.type is DataType.VOID:
        if not isinstance(value, (bytes, bytearray, memoryview)):
            raise DataError(f"void[]: {_shown(value)} is no bytes")
        packed = bytes(value)
        return packed, packed, len(packed), None
    if not isinstance(value, (list, tuple)):
        array = f" or numpy array of dtype {form.dtype}" if form.dtype else ""
        raise DataError(f"{form.name}[]: {_shown(value)} is no list or tuple{array}")
    packed = _pack_elements(form, _without_numpy(value))
    return None, packed, len(packed), None


def _store_scalar(form: _Form, value: Any) -> _Stored:
    if form == _VOID:
        if value is not None:
            raise DataError(f"void: {_shown(value)} is not None; bytes need is_ptr=True")
        return None, b"", 0, None
    if _is_numpy(value, "generic"):
        value = value.item()
    if form.code == "c":
        code = ord(value) if isinstance(value, str) and len(value) == 1 else value
        if isinstance(code, bool) or not isinstance(code, int) or not 0 <= code < 128:
            hint = "; more characters need is_ptr=True" if isinstance(value, str) and len(value) > 1 else ""
            raise DataError(f"char: {_shown(value)} is not {form.takes}{hint}")
        return chr(code), None, form.width, None
    packed = _pack_element(form, value)
    if packed is None:
        raise DataError(f"{form.name}: {_shown(value)} is not {form.takes}")
    return struct.unpack(f"<{form.code}", packed)[0], packed, form.width, None


def _store_text(value: Any, length: int | None) -> _Stored:
    if not isinstance(value, str):
        raise DataError(f"char[]: {_shown(value)} is no str; for numbers there is unsigned char, for bytes VOID")
    if "\0" in value:
        raise DataError(f"char[]: {_shown(value)} holds a zero character, where text ends in C")
    value = str.__str__(value)  # what a subclass adds does not cross
    try:
        needed = len(value) if value.isascii() else len(value.encode())
    except UnicodeEncodeError as error:
        raise DataError(f"char[]: {_shown(value)} is no UTF-8 text: {error.reason}") from error
    if length is not None and length < needed:
        raise DataError(f"length: the text takes {needed} bytes, more than {length}")
    return value, None, needed if length is None else length, None


def _store_array(form: _Form, array: np.ndarray[Any, Any]) -> _Stored:
    if not form.is_ptr or form.dtype != array.dtype.str:
        allowed = f"an array of dtype {form.dtype}" if form.is_ptr and form.dtype else "no numpy array"
        hint = "; arrays need is_ptr=True" if not form.is_ptr else ""
        name = f"{form.name}{'[]' * form.is_ptr}"
        raise DataError(f"{name}: given a numpy array of dtype {array.dtype.str}, takes {allowed}{hint}")
    view = array.view()
    view.flags.writeable = False
    return view, None, view.nbytes, view.shape


def _pack_elements(form: _Form, values: Sequence[Any]) -> bytes:
    if all(_is_element(form, kind) for kind in set(map(type, values))):
        try:
            return struct.pack(f"<{len(values)}{form.code}", *values)
        except (struct.error, OverflowError):
            pass
    index = next(index for index, value in enumerate(values) if _pack_element(form, value) is None)
    raise DataError(f"{form.name}[{index}]: {_shown(values[index])} is not {form.takes}")


def _is_element(form: _Form, kind: type) -> bool:
    return kind is bool if form.type is DataType.BOOL else kind is not bool and issubclass(kind, _NUMBERS[form.type])


def _pack_element(form: _Form, value: object) -> bytes | None:
    """Pack one number, or return None if it does not fit."""
    if not _is_element(form, type(value)):
        return None
    try:
        return struct.pack(f"<{form.code}", value)
    except (struct.error, OverflowError):
        return None


def _as_bytes(payload: bytes | bytearray | memoryview) -> Payload:
    if isinstance(payload, bytes):
        return payload
    try:
        view = memoryview(payload)
    except TypeError as error:
        raise DataError(f"payload: {_shown(payload)} is no bytes, bytearray or memoryview") from error
    if not view.c_contiguous:
        raise DataError("payload: the memoryview is not contiguous")
    return view.cast("B").toreadonly() if view.nbytes else b""


def _read(form: _Form, payload: Payload) -> _Stored:
    """Check bytes against their form; numbers in arrays are read when they are asked for."""
    length = len(payload)
    if not form.is_ptr and length != form.width:
        raise DataError(f"payload: {form.name} takes {form.width} bytes, not {length}")
    if form.is_ptr and length % form.width:
        raise DataError(f"payload: {length} bytes are no whole number of {form.name}, {form.width} bytes each")
    if form.type is DataType.VOID:
        return None, payload, length, None
    if form == _TEXT:
        try:
            return bytes(payload).partition(b"\0")[0].decode(), payload, length, None
        except UnicodeDecodeError as error:
            raise DataError(f"payload: no UTF-8 text at byte {error.start}: {error.reason}") from error
    if form.is_ptr:
        return None, payload, length, None
    return _store_scalar(form, payload[0] if form.code == "c" else struct.unpack(f"<{form.code}", payload)[0])


def _checked_shape(form: _Form, length: int, shape: Sequence[int] | None, dtype: str | None) -> tuple[int, ...]:
    if shape is None or dtype is None:
        raise DataError(f"shape {_shown(shape)} and dtype {_shown(dtype)} must be given together")
    if not form.is_ptr or form.dtype is None or dtype != form.dtype:
        takes = form.dtype if form.is_ptr and form.dtype else "no numpy array"
        raise DataError(f"dtype: {_shown(dtype)} does not fit {form.name}{'[]' * form.is_ptr}, which takes {takes}")
    if not isinstance(shape, (list, tuple)) or len(shape) > _MOST_DIMENSIONS:
        raise DataError(f"shape: {_shown(shape)} is no list of at most {_MOST_DIMENSIONS} sizes")
    if any(type(size) is not int or size < 0 for size in shape):
        raise DataError(f"shape: {_shown(shape)} holds what is no size, an int from 0")
    if math.prod(shape) * form.width != length:
        raise DataError(f"shape: {_shown(shape)} of {form.width} bytes each does not fit {length} bytes")
    if math.prod(size or 1 for size in shape) * form.width > sys.maxsize:
        raise DataError(f"shape: {_shown(shape)} is too large for an array, even without elements")
    return tuple(shape)


def _unpack(form: _Form, payload: Payload) -> list[Any]:
    return list(struct.unpack(f"<{len(payload) // form.width}{form.code}", payload))


def _as_array(payload: Payload, shape: tuple[int, ...], form: _Form) -> np.ndarray[Any, Any]:
    try:
        import numpy as np
    except ImportError as error:
        raise DataError(f"value: an array of dtype {form.dtype} needs numpy; `payload` serves without") from error
    return np.ndarray(shape, form.dtype, buffer=payload)


def _is_numpy(value: object, name: str) -> bool:
    """Tell whether a value is a `numpy.<name>`, without importing numpy: nobody holds one before it is imported."""
    return type(value) not in _BUILTINS and isinstance(value, getattr(sys.modules.get("numpy"), name, ()))


def _without_numpy(values: Sequence[Any]) -> Sequence[Any]:
    """Turn numpy scalars into Python numbers."""
    if set(map(type, values)) <= _BUILTINS:
        return values
    return [value.item() if _is_numpy(value, "generic") else value for value in values]


class _Short(reprlib.Repr):
    """Shows a value in a message, short however large it is."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlist = self.maxtuple = _SHOWN_ELEMENTS
        self.maxstring = 60

    def repr_int(self, x: int, level: int) -> str:  # noqa: ARG002
        return repr(x) if x.bit_length() <= 128 else f"<int of {x.bit_length()} bits>"

    def repr_bytes(self, x: bytes, level: int) -> str:  # noqa: ARG002
        return repr(x) if len(x) <= _SHOWN_BYTES else f"{x[:_SHOWN_BYTES]!r}..."


_shown: Final = _Short().repr
