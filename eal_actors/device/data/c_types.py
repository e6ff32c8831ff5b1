"""The C types that data may have, as plain values and as arrays, in one table."""

from __future__ import annotations

import enum
import reprlib
import struct
import sys
from typing import Final, NamedTuple

from eal_actors.kernel.errors import DataError


class DataType(enum.Enum):
    """The base types (Source: thesis B.1.1)."""

    INT = "int"
    CHAR = "char"
    FLOAT = "float"
    DOUBLE = "double"
    BOOL = "bool"
    VOID = "void"

    __hash__ = object.__hash__  # by identity: several times faster than by name


class CType(NamedTuple):
    """A C type, plain or as an array."""

    type: DataType
    is_ptr: bool
    is_unsigned: bool
    is_short: bool
    is_long: bool
    name: str  # of one element, as C writes it
    code: str  # of one element, as `struct` writes it
    width: int  # bytes of one element; 0 for a void that is no array
    takes: str  # the valid elements, for messages
    dtype: str | None  # the numpy dtype of an array, None where numpy arrays are not taken
    full_name: str  # as C writes it, with [] for an array


_UNSIGNED, _SHORT, _LONG = (True, False, False), (False, True, False), (False, False, True)
_UNSIGNED_SHORT, _UNSIGNED_LONG, PLAIN = (True, True, False), (True, False, True), (False, False, False)
_TABLE: Final = (
    (DataType.INT, PLAIN, "int", "i", f"an int in {-(2**31)}..{2**31 - 1}", "<i4"),
    (DataType.INT, _UNSIGNED, "unsigned int", "I", f"an int in 0..{2**32 - 1}", "<u4"),
    (DataType.INT, _SHORT, "short", "h", f"an int in {-(2**15)}..{2**15 - 1}", "<i2"),
    (DataType.INT, _UNSIGNED_SHORT, "unsigned short", "H", f"an int in 0..{2**16 - 1}", "<u2"),
    (DataType.INT, _LONG, "long", "q", f"an int in {-(2**63)}..{2**63 - 1}", "<i8"),
    (DataType.INT, _UNSIGNED_LONG, "unsigned long", "Q", f"an int in 0..{2**64 - 1}", "<u8"),
    (DataType.CHAR, PLAIN, "char", "c", "one ASCII character or its code, an int in 0..127", None),
    (DataType.CHAR, _UNSIGNED, "unsigned char", "B", "an int in 0..255", "|u1"),
    (DataType.FLOAT, PLAIN, "float", "f", "a float or int up to 3.4e38", "<f4"),
    (DataType.DOUBLE, PLAIN, "double", "d", "a float or int up to 1.7e308", "<f8"),
    (DataType.BOOL, PLAIN, "bool", "?", "True or False", "|b1"),
    (DataType.VOID, PLAIN, "void", "s", "None", None),
)
C_TYPES: Final = {
    (kind, is_ptr, *modifiers): CType(
        kind,
        is_ptr,
        *modifiers,
        name,
        code,
        struct.calcsize(f"<{code}") if name != "void" or is_ptr else 0,
        takes,
        dtype,
        name + "[]" * is_ptr,
    )
    for kind, modifiers, name, code, takes, dtype in _TABLE
    for is_ptr in (False, True)
}
ARRAY_BY_DTYPE: Final = {c_type.dtype: c_type for c_type in C_TYPES.values() if c_type.dtype and c_type.is_ptr}
SCALAR_BY_DTYPE: Final = {c_type.dtype: c_type for c_type in C_TYPES.values() if c_type.dtype and not c_type.is_ptr}
INTS: Final = {
    is_ptr: [C_TYPES[DataType.INT, is_ptr, *modifiers] for modifiers in (PLAIN, _LONG, _UNSIGNED_LONG)]
    for is_ptr in (False, True)
}
INT: Final = C_TYPES[DataType.INT, False, *PLAIN]
DOUBLE: Final = C_TYPES[DataType.DOUBLE, False, *PLAIN]
BOOL: Final = C_TYPES[DataType.BOOL, False, *PLAIN]
VOID: Final = C_TYPES[DataType.VOID, False, *PLAIN]
TEXT: Final = C_TYPES[DataType.CHAR, True, *PLAIN]
BYTES: Final = C_TYPES[DataType.VOID, True, *PLAIN]

NUMBERS: Final[dict[DataType, tuple[type, ...]]] = {
    DataType.INT: (int,),
    DataType.CHAR: (int,),
    DataType.FLOAT: (float, int),
    DataType.DOUBLE: (float, int),
}
NUMERIC_TYPES: Final = (DataType.INT, DataType.FLOAT, DataType.DOUBLE)
BUILTINS: Final = frozenset({int, float, bool, str, bytes, bytearray, memoryview, list, tuple, type(None)})
MOST_DIMENSIONS: Final = 32  # of numpy 1.26
SHOWN_ELEMENTS: Final = 6
SHOWN_BYTES: Final = 24


def find_c_type(kind: DataType, is_ptr: bool, is_unsigned: bool, is_short: bool, is_long: bool) -> CType:
    """Return a C type, or raise DataError naming the valid ones."""
    try:
        return C_TYPES[kind, is_ptr, is_unsigned, is_short, is_long]
    except (KeyError, TypeError):
        pass
    if not isinstance(kind, DataType):
        raise DataError(f"type: {short_repr(kind)} is no DataType; there are {', '.join(DataType.__members__)}")
    flags = {"is_ptr": is_ptr, "is_unsigned": is_unsigned, "is_short": is_short, "is_long": is_long}
    for name, flag in flags.items():
        if not isinstance(flag, bool):
            raise DataError(f"{name}: {short_repr(flag)} is no bool")
    given = "".join(f"{name[3:]} " for name in list(flags)[1:] if flags[name])
    allowed = ", ".join(c_type.name for c_type in C_TYPES.values() if c_type.type is kind and not c_type.is_ptr)
    why = "; long double has no size common to all machines" if kind is DataType.DOUBLE and is_long else ""
    raise DataError(f"there is no {given}{kind.value} here, only {allowed}{why}")


def int_c_type(low: int, high: int, *, is_ptr: bool) -> CType:
    """Return the narrowest of int, long and unsigned long that holds all of low..high, or raise DataError."""
    plain, long, unsigned_long = INTS[is_ptr]
    if low >= -(2**31) and high < 2**31:
        return plain
    if low >= -(2**63) and high < 2**63:
        return long
    if low >= 0 and high < 2**64:
        return unsigned_long
    culprit = short_repr(low) if low == high else f"a list from {short_repr(low)} to {short_repr(high)}"
    raise DataError(f"{culprit} fits neither long, {-(2**63)}..{2**63 - 1}, nor unsigned long, 0..{2**64 - 1}")


def is_numpy(value: object, name: str) -> bool:
    """Return whether a value is a `numpy.<name>`, without importing numpy: no such value exists before the import."""
    return type(value) not in BUILTINS and isinstance(value, getattr(sys.modules.get("numpy"), name, ()))


class _ShortRepr(reprlib.Repr):
    """The repr of a value for a message, short even for large values."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlist = self.maxtuple = SHOWN_ELEMENTS
        self.maxstring = 60

    def repr_int(self, x: int, level: int) -> str:  # noqa: ARG002
        return repr(x) if x.bit_length() <= 128 else f"<int of {x.bit_length()} bits>"

    def repr_bytes(self, x: bytes, level: int) -> str:  # noqa: ARG002
        return repr(x) if len(x) <= SHOWN_BYTES else f"{x[:SHOWN_BYTES]!r}..."


short_repr: Final = _ShortRepr().repr
