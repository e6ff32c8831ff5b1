from __future__ import annotations

import math
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eal_actors.data import DataType, EALData
from eal_actors.errors import DataError

INT, CHAR, FLOAT, DOUBLE, BOOL, VOID = DataType
PTR, UNSIGNED, SHORT, LONG = ({"is_ptr": True}, {"is_unsigned": True}, {"is_short": True}, {"is_long": True})
MODIFIERS = ("is_ptr", "is_unsigned", "is_short", "is_long")


def modifiers_of(data: EALData) -> dict[str, Any]:
    return {name: True for name in MODIFIERS if getattr(data, name)}


def rebuilt(data: EALData, payload: Any = None) -> EALData:
    """Take data apart and rebuild it, as the network does."""
    return EALData.from_payload(
        data.type,
        bytes(data.payload) if payload is None else payload,
        **modifiers_of(data),
        shape=data.shape,
        dtype=data.dtype,
        unit=data.unit,
        frame_id=data.frame_id,
        stamp_s=data.stamp_s,
    )


# The expected bytes are what gcc lays out on x86-64 and aarch64, in hexadecimal.
C_LAYOUT = [
    pytest.param(INT, 42, {}, "2a000000", id="thesis B.1.2.1: int 42"),
    pytest.param(CHAR, "s", {}, "73", id="thesis B.1.2.1: char 's'"),
    pytest.param(
        INT,
        [0, 1, 2, 3, 4, 5, 6, 7, 8, 9],
        PTR,
        "00000000 01000000 02000000 03000000 04000000 05000000 06000000 07000000 08000000 09000000",
        id="thesis B.1.2.2: int[10]",
    ),
    pytest.param(INT, 1000000, LONG, "40420f0000000000", id="thesis B.1.2.2: long 1000000"),
    pytest.param(INT, -2, {}, "feffffff", id="int -2"),
    pytest.param(INT, -(2**31), {}, "00000080", id="least int"),
    pytest.param(INT, 2**31 - 1, {}, "ffffff7f", id="greatest int"),
    pytest.param(INT, 2**32 - 1, UNSIGNED, "ffffffff", id="greatest unsigned int"),
    pytest.param(INT, -(2**15), SHORT, "0080", id="least short"),
    pytest.param(INT, 2**16 - 1, SHORT | UNSIGNED, "ffff", id="greatest unsigned short"),
    pytest.param(INT, -(2**63), LONG, "0000000000000080", id="least long"),
    pytest.param(INT, 2**64 - 1, LONG | UNSIGNED, "ffffffffffffffff", id="greatest unsigned long"),
    pytest.param(INT, [-1, 258], PTR | SHORT, "ffff0201", id="short[2]"),
    pytest.param(INT, [], PTR, "", id="int[0]"),
    pytest.param(CHAR, 255, UNSIGNED, "ff", id="greatest unsigned char"),
    pytest.param(CHAR, [1, 2, 255], PTR | UNSIGNED, "0102ff", id="unsigned char[3]"),
    pytest.param(CHAR, "hé", PTR, "68c3a9", id="UTF-8 text"),
    pytest.param(CHAR, "", PTR, "", id="empty text"),
    pytest.param(FLOAT, 1.5, {}, "0000c03f", id="float"),
    pytest.param(FLOAT, -math.inf, {}, "000080ff", id="float -infinity"),
    pytest.param(FLOAT, [1.0, -2.0], PTR, "0000803f000000c0", id="float[2]"),
    pytest.param(DOUBLE, 1.5, {}, "000000000000f83f", id="double"),
    pytest.param(DOUBLE, 2, {}, "0000000000000040", id="double of an int"),
    pytest.param(DOUBLE, [0.5, 1], PTR, "000000000000e03f000000000000f03f", id="double[2]"),
    pytest.param(BOOL, True, {}, "01", id="bool"),
    pytest.param(BOOL, [True, False], PTR, "0100", id="bool[2]"),
    pytest.param(VOID, None, {}, "", id="void"),
    pytest.param(VOID, b"\x00\xff", PTR, "00ff", id="void[2]"),
]


@pytest.mark.parametrize(("kind", "value", "modifiers", "layout"), C_LAYOUT)
def test_payload_is_laid_out_as_in_c(kind: DataType, value: Any, modifiers: dict[str, Any], layout: str) -> None:
    expected = bytes.fromhex(layout)
    data = EALData(kind, value, len(expected), **modifiers)

    assert bytes(data.payload) == expected
    assert data.length == len(expected)
    assert data.type is kind
    assert modifiers_of(data) == modifiers
    assert data.value == value
    assert (data.shape, data.dtype) == (None, None)


@pytest.mark.parametrize(("kind", "value", "modifiers", "layout"), C_LAYOUT)
def test_value_is_read_from_c_bytes(kind: DataType, value: Any, modifiers: dict[str, Any], layout: str) -> None:
    for payload in (bytes.fromhex(layout), bytearray.fromhex(layout), memoryview(bytes.fromhex(layout))):
        data = EALData.from_payload(kind, payload, **modifiers)

        assert data.value == value
        assert type(data.value) is (float if kind in {FLOAT, DOUBLE} and not data.is_ptr else type(value))
        assert bytes(data.payload) == bytes.fromhex(layout)
        assert data == EALData(kind, value, **modifiers)


def test_text_in_a_longer_array_is_filled_with_zeros() -> None:  # thesis B.1.2.2: "hello" in char[10]
    data = EALData(CHAR, "hello", 10, is_ptr=True)

    assert data.payload == b"hello\0\0\0\0\0"
    assert data.length == 10
    assert data.value == "hello"
    assert rebuilt(data).value == "hello"


def test_text_ends_at_its_first_zero_whatever_follows() -> None:  # strcpy leaves the rest of new char[10] as it was
    data = EALData.from_payload(CHAR, b"hello\0\xfe\xff!!", is_ptr=True)

    assert data.value == "hello"
    assert data.payload == b"hello\0\xfe\xff!!"


def test_char_takes_its_code() -> None:
    assert EALData(CHAR, 115).value == "s"
    assert EALData(CHAR, 115) == EALData(CHAR, "s")


def test_float_reads_back_rounded_as_at_the_other_end() -> None:
    data = EALData(FLOAT, 0.1)

    assert data.value == 0.10000000149011612
    assert rebuilt(data).value == data.value


NO_VALUES = [
    (INT, 2**31, {}, None, "int: 2147483648 is not an int in -2147483648..2147483647"),
    (INT, -(2**31) - 1, {}, None, "int: -2147483649 is not"),
    (INT, 2**32, UNSIGNED, None, "unsigned int: 4294967296 is not an int in 0..4294967295"),
    (INT, -1, UNSIGNED, None, "unsigned int: -1 is not"),
    (INT, 2**15, SHORT, None, "short: 32768 is not an int in -32768..32767"),
    (INT, 2**16, SHORT | UNSIGNED, None, "unsigned short: 65536 is not an int in 0..65535"),
    (INT, 2**63, LONG, None, "long: 9223372036854775808 is not"),
    (INT, 2**64, LONG | UNSIGNED, None, "unsigned long: 18446744073709551616 is not"),
    pytest.param(INT, 10**5000, {}, None, "int: <int of 16610 bits> is not", id="an int too long for str()"),
    (INT, math.nan, {}, None, "int: nan is not an int"),
    (INT, 3.0, {}, None, "int: 3.0 is not an int"),
    (INT, True, {}, None, "int: True is not an int"),
    (INT, "3", {}, None, "int: '3' is not an int"),
    (INT, None, {}, None, "int: None is not an int"),
    (INT, [1], {}, None, r"int: \[1\] is not an int"),
    (INT, 1, PTR, None, r"int\[\]: 1 is no list or tuple or numpy array of dtype <i4"),
    (INT, [1, 2, 2**31], PTR, None, r"int\[2\]: 2147483648 is not an int in"),
    (INT, [1, True], PTR, None, r"int\[1\]: True is not an int"),
    (INT, [1, 2.0], PTR, None, r"int\[1\]: 2.0 is not an int"),
    (INT, [1, None], PTR, None, r"int\[1\]: None is not an int"),
    (CHAR, 300, {}, None, "char: 300 is not one ASCII character or its code, an int in 0..127"),
    (CHAR, -1, {}, None, "char: -1 is not"),
    (CHAR, "é", {}, None, "char: 'é' is not one ASCII character"),
    (CHAR, "no", {}, None, "char: 'no' is not one ASCII character .* need is_ptr=True"),
    (CHAR, "", {}, None, "char: '' is not one ASCII character"),
    (CHAR, True, {}, None, "char: True is not"),
    (CHAR, 256, UNSIGNED, None, "unsigned char: 256 is not an int in 0..255"),
    (CHAR, "s", UNSIGNED, None, "unsigned char: 's' is not an int in 0..255"),
    (CHAR, b"hello", PTR, None, r"char\[\]: b'hello' is no str"),
    (CHAR, [104], PTR, None, r"char\[\]: \[104\] is no str"),
    (CHAR, "a\0b", PTR, None, r"char\[\]: 'a\\x00b' holds a zero character"),
    (CHAR, "\ud800", PTR, None, "is no UTF-8 text: surrogates not allowed"),
    (FLOAT, 1e39, {}, None, "float: 1e[+]39 is not a float or int up to 3.4e38"),
    (FLOAT, [0.0, -1e39], PTR, None, r"float\[1\]: -1e[+]39 is not"),
    (FLOAT, True, {}, None, "float: True is not"),
    (DOUBLE, 10**400, {}, None, "double: <int of 1329 bits> is not"),
    (DOUBLE, "1.5", {}, None, "double: '1.5' is not"),
    (DOUBLE, None, {}, None, "double: None is not"),
    (BOOL, 1, {}, None, "bool: 1 is not True or False"),
    (BOOL, [True, 0], PTR, None, r"bool\[1\]: 0 is not True or False"),
    (VOID, 1, {}, None, "void: 1 is not None"),
    (VOID, b"abc", {}, None, "void: b'abc' is not None; bytes need is_ptr=True"),
    (VOID, None, PTR, None, r"void\[\]: None is no bytes"),
    (VOID, "abc", PTR, None, r"void\[\]: 'abc' is no bytes"),
    (INT, 42, {}, 0, "length: this int takes 4 bytes, not 0"),
    (INT, 42, {}, 8, "length: this int takes 4 bytes, not 8; is_long=True makes an int 8 bytes"),
    (INT, 42, LONG, 4, "length: this long takes 8 bytes, not 4"),
    (INT, [1, 2], PTR, 12, r"length: this int\[\] takes 8 bytes, not 12"),
    (CHAR, "hello", PTR, 4, "length: the text takes 5 bytes, more than 4"),
    (CHAR, "éé", PTR, 3, "length: the text takes 4 bytes, more than 3"),
    (VOID, None, {}, 1, "length: this void takes 0 bytes, not 1"),
    (INT, 42, {}, -4, "length: -4 is no number of bytes"),
    (INT, 42, {}, 4.0, "length: 4.0 is no number of bytes"),
    (BOOL, True, {}, True, "length: True is no number of bytes"),
]


@pytest.mark.parametrize(("kind", "value", "modifiers", "length", "message"), NO_VALUES)
def test_value_that_does_not_fit_is_refused(
    kind: DataType, value: Any, modifiers: dict[str, Any], length: Any, message: str
) -> None:
    with pytest.raises(DataError, match=message):
        EALData(kind, value, length, **modifiers)


NO_TYPES = [
    (INT, SHORT | LONG, "no short long int here, only int, unsigned int, short,"),
    (CHAR, LONG, "no long char here, only char, unsigned char$"),
    (CHAR, SHORT, "no short char"),
    (CHAR, UNSIGNED | LONG, "no unsigned long char"),
    (FLOAT, UNSIGNED, "no unsigned float here, only float$"),
    (FLOAT, LONG, "no long float"),
    (DOUBLE, UNSIGNED, "no unsigned double here, only double$"),
    (DOUBLE, SHORT, "no short double"),
    (DOUBLE, LONG, "no long double here, only double; long double has no size common to all machines"),
    (BOOL, UNSIGNED, "no unsigned bool"),
    (VOID, LONG, "no long void"),
    ("INT", {}, "type: 'INT' is no DataType; there are INT, CHAR, FLOAT, DOUBLE, BOOL, VOID"),
    (None, {}, "type: None is no DataType"),
    ([], {}, r"type: \[\] is no DataType"),
    (INT, {"is_short": "yes"}, "is_short: 'yes' is no bool"),
    (INT, {"is_long": []}, r"is_long: \[\] is no bool"),
]


@pytest.mark.parametrize(("kind", "modifiers", "message"), NO_TYPES)
def test_contradiction_is_refused_whatever_the_value(kind: Any, modifiers: dict[str, Any], message: str) -> None:
    for is_ptr in (False, True):
        with pytest.raises(DataError, match=message):
            EALData(kind, 1, is_ptr=is_ptr, **modifiers)
        with pytest.raises(DataError, match=message):
            EALData.from_payload(kind, b"\1", is_ptr=is_ptr, **modifiers)


NO_PAYLOADS = [
    (INT, b"\0\0\0", {}, "payload: int takes 4 bytes, not 3"),
    (INT, bytes(4), LONG, "payload: long takes 8 bytes, not 4"),
    (INT, bytes(6), PTR, "payload: 6 bytes are no whole number of int, 4 bytes each"),
    (CHAR, b"\x80", {}, "char: 128 is not one ASCII character"),
    (CHAR, b"ab\xff", PTR, "payload: no UTF-8 text at byte 2"),
    (BOOL, b"\2", {}, "payload: a bool is 0 or 1"),
    (BOOL, b"\1\0\2\0", PTR, "payload: a bool is 0 or 1"),
    (BOOL, b"\1\0\2\0", PTR | {"shape": (4,), "dtype": "|b1"}, "payload: a bool is 0 or 1"),
    (VOID, b"a", {}, "payload: void takes 0 bytes, not 1"),
    (VOID, "text", PTR, "payload: 'text' is no bytes, bytearray or memoryview"),
    (VOID, memoryview(b"abcd")[::2], PTR, "payload: the memoryview is not contiguous"),
    (INT, bytes(8), PTR | {"shape": (2,)}, r"shape \(2,\) and dtype None must be given together"),
    (INT, bytes(8), PTR | {"dtype": "<i4"}, "shape None and dtype '<i4' must be given together"),
    (INT, bytes(8), PTR | {"shape": (2,), "dtype": "<f4"}, r"dtype: '<f4' does not fit int\[\], which takes <i4"),
    (INT, bytes(8), PTR | {"shape": (2,), "dtype": ">i4"}, "dtype: '>i4' does not fit"),
    (INT, bytes(4), {"shape": (), "dtype": "<i4"}, "dtype: '<i4' does not fit int, which takes no numpy array"),
    (INT, bytes(8), PTR | {"shape": (3,), "dtype": "<i4"}, r"shape: \(3,\) of 4 bytes each does not fit 8 bytes"),
    (INT, bytes(8), PTR | {"shape": (-1, -2), "dtype": "<i4"}, "holds what is no size"),
    (INT, bytes(8), PTR | {"shape": (2.0,), "dtype": "<i4"}, "holds what is no size"),
    (INT, bytes(8), PTR | {"shape": 2, "dtype": "<i4"}, "shape: 2 is no list of at most 32 sizes"),
    (INT, b"", PTR | {"shape": (0, 2**62, 2**62), "dtype": "<i4"}, "too large for an array"),
    (INT, bytes(4), PTR | {"shape": (1,) * 33, "dtype": "<i4"}, "no list of at most 32 sizes"),
]


@pytest.mark.parametrize(("kind", "payload", "arguments", "message"), NO_PAYLOADS)
def test_payload_that_does_not_fit_is_refused(
    kind: DataType, payload: Any, arguments: dict[str, Any], message: str
) -> None:
    with pytest.raises(DataError, match=message):
        EALData.from_payload(kind, payload, **arguments)


INFERRED = [
    (True, BOOL, {}, "01"),
    (0, INT, {}, "00000000"),
    (-(2**31), INT, {}, "00000080"),
    (2**31 - 1, INT, {}, "ffffff7f"),
    (2**31, INT, LONG, "0000008000000000"),
    (-(2**31) - 1, INT, LONG, "ffffff7fffffffff"),
    (2**63 - 1, INT, LONG, "ffffffffffffff7f"),
    (-(2**63), INT, LONG, "0000000000000080"),
    (2**63, INT, LONG | UNSIGNED, "0000000000000080"),
    (2**64 - 1, INT, LONG | UNSIGNED, "ffffffffffffffff"),
    (-0.5, DOUBLE, {}, "000000000000e0bf"),
    ("hello", CHAR, PTR, "68656c6c6f"),
    ("", CHAR, PTR, ""),
    (b"\1\2", VOID, PTR, "0102"),
    (None, VOID, {}, ""),
    ([True, False], BOOL, PTR, "0100"),
    ([1, -1], INT, PTR, "01000000ffffffff"),
    ([1, 2**31], INT, PTR | LONG, "01000000000000000000008000000000"),
    ([0, 2**63], INT, PTR | LONG | UNSIGNED, "00000000000000000000000000000080"),
    ([1, 0.5], DOUBLE, PTR, "000000000000f03f000000000000e03f"),
]


@pytest.mark.parametrize(("value", "kind", "modifiers", "layout"), INFERRED)
def test_of_finds_the_type(value: Any, kind: DataType, modifiers: dict[str, Any], layout: str) -> None:
    data = EALData.of(value)

    assert (data.type, modifiers_of(data)) == (kind, modifiers)
    assert bytes(data.payload) == bytes.fromhex(layout)
    assert data.length == len(layout) // 2
    assert data.value == value
    assert type(data.value) is type(value)
    assert rebuilt(data) == data


def test_of_tuple_and_buffers_read_back_as_list_and_bytes() -> None:
    assert EALData.of((1, 2)).value == [1, 2]
    for buffer in (bytearray(b"ab"), memoryview(b"ab")):
        assert EALData.of(buffer).value == b"ab"


def test_of_does_not_follow_a_buffer_that_changes() -> None:
    buffer = bytearray(b"ab")
    data = EALData.of(buffer)
    buffer[0] = 0

    assert data.payload == b"ab"


def test_of_empty_list_is_an_empty_void_array() -> None:
    data = EALData.of([])

    assert (data.type, data.is_ptr, data.length, data.value) == (VOID, True, 0, b"")


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (2**64, "18446744073709551616 fits neither long, .* nor unsigned long"),
        (-(2**63) - 1, "-9223372036854775809 fits neither long"),
        ([-1, 2**63], "a list from -1 to 9223372036854775808 fits neither long"),
        ([1, True], "a list of bool, int has no type"),
        ([1, "a"], "a list of int, str has no type"),
        ([[1], [2]], "a list of list has no type"),
        ([1.0, 10**400], r"double\[1\]: <int of 1329 bits> is not"),
        (1j, "no type fits .*, a complex; there are types for bool, int"),
        ({"a": 1}, "no type fits {'a': 1}, a dict"),
        (object, "no type fits .*, a type"),
    ],
)
def test_of_refuses_what_has_no_type(value: Any, message: str) -> None:
    with pytest.raises(DataError, match=message):
        EALData.of(value)


def test_of_data_returns_it_as_it_is() -> None:
    data = EALData.of(1.5, unit="m")

    assert EALData.of(data) is data


def test_of_data_changes_what_is_given() -> None:
    data = EALData.of(1.5, unit="m", frame_id="base")
    stamped = EALData.of(data, stamp_s=2)

    assert (stamped.value, stamped.unit, stamped.frame_id, stamped.stamp_s) == (1.5, "m", "base", 2.0)
    assert type(stamped.stamp_s) is float
    assert data.stamp_s is None


def test_with_meta_shares_the_value() -> None:
    frame = np.zeros((2, 3), np.uint8)
    data = EALData.of(frame).with_meta(unit="1", frame_id="camera", stamp_s=0.5)

    assert np.shares_memory(data.value, frame)
    assert (data.unit, data.frame_id, data.stamp_s, data.shape) == ("1", "camera", 0.5, (2, 3))
    assert data.with_meta() is data


@pytest.mark.parametrize(
    ("meta", "message"),
    [
        ({"unit": 3}, "unit: 3 is no str"),
        ({"frame_id": b"base"}, "frame_id: b'base' is no str"),
        ({"stamp_s": "now"}, "stamp_s: 'now' is no finite number of seconds"),
        ({"stamp_s": math.nan}, "stamp_s: nan is no finite number"),
        ({"stamp_s": -math.inf}, "stamp_s: -inf is no finite number"),
        ({"stamp_s": 10**400}, "stamp_s: <int of 1329 bits> is no finite number"),
        ({"stamp_s": True}, "stamp_s: True is no finite number"),
    ],
)
def test_meta_is_checked_wherever_it_is_given(meta: dict[str, Any], message: str) -> None:
    with pytest.raises(DataError, match=message):
        EALData.of(1, **meta)
    with pytest.raises(DataError, match=message):
        EALData(INT, 1, **meta)
    with pytest.raises(DataError, match=message):
        EALData.from_payload(INT, bytes(4), **meta)
    with pytest.raises(DataError, match=message):
        EALData.of(1).with_meta(**meta)


NUMPY_TYPES = [
    ("|u1", CHAR, UNSIGNED, "01ff", [1, 255]),
    ("<i2", INT, SHORT, "01000080", [1, -(2**15)]),
    ("<i4", INT, {}, "0100000000000080", [1, -(2**31)]),
    ("<i8", INT, LONG, "01000000000000000000000000000080", [1, -(2**63)]),
    ("<f4", FLOAT, {}, "0000803f0000c0bf", [1.0, -1.5]),
    ("<f8", DOUBLE, {}, "000000000000f03f000000000000f8bf", [1.0, -1.5]),
    ("|b1", BOOL, {}, "0100", [True, False]),
]


@pytest.mark.parametrize(("dtype", "kind", "modifiers", "layout", "values"), NUMPY_TYPES)
def test_numpy_array_crosses_without_a_copy(
    dtype: str, kind: DataType, modifiers: dict[str, Any], layout: str, values: list[Any]
) -> None:
    array = np.array([values], dtype)
    data = EALData.of(array)

    assert (data.type, modifiers_of(data), data.shape, data.dtype) == (kind, modifiers | PTR, (1, 2), dtype)
    assert bytes(data.payload) == bytes.fromhex(layout)
    assert data.length == len(layout) // 2
    assert np.shares_memory(data.value, array)
    assert np.shares_memory(np.frombuffer(data.payload, np.uint8), array)
    assert data == EALData(kind, array, **modifiers, is_ptr=True)

    received = rebuilt(data, data.payload)
    assert np.shares_memory(received.value, array)
    assert received.value.tolist() == [values]
    assert received.value.dtype.str == dtype
    assert received.value is received.value
    assert received == data


@pytest.mark.parametrize(("dtype", "kind", "modifiers", "layout", "values"), NUMPY_TYPES)
def test_numpy_scalar_becomes_a_plain_value(
    dtype: str, kind: DataType, modifiers: dict[str, Any], layout: str, values: list[Any]
) -> None:
    scalar = np.array(values, dtype)[1]
    for data in (EALData.of(scalar), EALData(kind, scalar, **modifiers)):
        assert (data.type, modifiers_of(data), data.shape, data.dtype) == (kind, modifiers, None, None)
        assert data.value == values[1]
        assert type(data.value) is type(values[1])
        assert bytes(data.payload) == bytes.fromhex(layout)[len(layout) // 4 :]


def test_list_of_numpy_scalars_is_a_list_of_numbers() -> None:
    assert EALData.of(list(np.arange(3))).value == [0, 1, 2]
    assert EALData(FLOAT, [np.float64(0.5), 1], is_ptr=True).value == [0.5, 1.0]


@pytest.mark.parametrize(
    "value",
    [
        np.zeros(2, np.int8),
        np.zeros(2, np.float16),
        np.zeros(2, np.complex128),
        np.zeros(2, ">f4"),
        np.array(["a"]),
        np.array([None]),
        np.complex128(1j),
        np.str_("a"),
        np.bytes_(b"a"),
    ],
    ids=lambda value: str(value.dtype.str),
)
def test_other_numpy_types_are_refused(value: Any) -> None:
    known = r"<i4, <u4, <i2, <u2, <i8, <u8, \|u1, <f4, <f8, \|b1"
    with pytest.raises(DataError, match=rf"numpy dtype .* has no type here, only {known}"):
        EALData.of(value)


@pytest.mark.parametrize(
    ("kind", "modifiers", "message"),
    [
        (DOUBLE, PTR, r"double\[\]: given a numpy array of dtype <f4, takes an array of dtype <f8"),
        (FLOAT, {}, "float: given a numpy array of dtype <f4, takes no numpy array; arrays need is_ptr=True"),
        (VOID, PTR, r"void\[\]: given a numpy array of dtype <f4, takes no numpy array"),
        (INT, PTR | UNSIGNED, r"unsigned int\[\]: given a numpy array of dtype <f4, takes an array of dtype <u4"),
    ],
)
def test_numpy_array_of_another_type_is_refused(kind: DataType, modifiers: dict[str, Any], message: str) -> None:
    with pytest.raises(DataError, match=message):
        EALData(kind, np.zeros(2, np.float32), **modifiers)


def test_readers_cannot_write_and_the_owner_keeps_a_writable_array() -> None:
    array = np.zeros(3, np.float32)
    data = EALData.of(array)

    with pytest.raises(ValueError, match="read-only"):
        data.value[0] = 1
    with pytest.raises(TypeError, match="read-only"):
        data.payload[0] = 1  # type: ignore[index]
    array[0] = 1


def test_rebuilt_array_is_read_only_even_in_a_writable_buffer() -> None:
    buffer = bytearray(4)
    data = EALData.from_payload(FLOAT, buffer, is_ptr=True, shape=[1], dtype="<f4")

    assert np.shares_memory(data.value, np.frombuffer(buffer, np.uint8))
    with pytest.raises(ValueError, match="read-only"):
        data.value[0] = 1


@pytest.mark.parametrize(
    ("array", "layout"),
    [
        (np.array([[1, 2], [3, 4]], np.uint8).T, "01030204"),
        (np.array([1, 2, 3, 4], np.uint8)[::-2], "0402"),
        (np.array(7, np.uint8), "07"),
        (np.zeros((0, 3), np.uint8), ""),
    ],
    ids=["transposed", "strided", "no dimension", "no element"],
)
def test_odd_arrays_are_packed_row_by_row(array: Any, layout: str) -> None:
    data = EALData.of(array)

    assert bytes(data.payload) == bytes.fromhex(layout)
    assert (data.shape, data.length) == (array.shape, len(layout) // 2)
    np.testing.assert_array_equal(rebuilt(data).value, array, strict=True)


INTEGERS = {
    (): (-(2**31), 2**31 - 1),
    ("is_unsigned",): (0, 2**32 - 1),
    ("is_short",): (-(2**15), 2**15 - 1),
    ("is_short", "is_unsigned"): (0, 2**16 - 1),
    ("is_long",): (-(2**63), 2**63 - 1),
    ("is_long", "is_unsigned"): (0, 2**64 - 1),
}
TEXTS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"))
ELEMENTS: list[tuple[DataType, tuple[str, ...], st.SearchStrategy[Any]]] = [
    *((INT, modifiers, st.integers(*limits)) for modifiers, limits in INTEGERS.items()),
    (CHAR, ("is_unsigned",), st.integers(0, 255)),
    (FLOAT, (), st.floats(width=32, allow_nan=False)),
    (DOUBLE, (), st.floats(allow_nan=False)),
    (BOOL, (), st.booleans()),
]


@st.composite
def typed_values(draw: st.DrawFn) -> tuple[DataType, Any, dict[str, Any]]:
    """Draw a type with every modifier it takes, and a value of it."""
    special: list[tuple[DataType, tuple[str, ...], st.SearchStrategy[Any]]] = [
        (CHAR, (), st.characters(codec="ascii")),
        (CHAR, ("is_ptr",), TEXTS),
        (VOID, (), st.none()),
        (VOID, ("is_ptr",), st.binary()),
    ]
    arrays = [(kind, (*names, "is_ptr"), st.lists(elements)) for kind, names, elements in ELEMENTS]
    kind, names, values = draw(st.sampled_from([*ELEMENTS, *arrays, *special]))
    return kind, draw(values), dict.fromkeys(names, True)


@given(typed_values(), st.none() | st.text(), st.none() | st.floats(allow_nan=False, allow_infinity=False))
def test_round_trip(typed: tuple[DataType, Any, dict[str, Any]], unit: str | None, stamp_s: float | None) -> None:
    kind, value, modifiers = typed
    data = EALData(kind, value, **modifiers, unit=unit, frame_id=unit, stamp_s=stamp_s)
    back = rebuilt(data)

    assert back.value == value
    assert type(back.value) is type(value)
    assert back == data
    assert back.length == data.length == len(data.payload)
    assert (back.unit, back.frame_id, back.stamp_s) == (unit, unit, stamp_s)


@given(TEXTS, st.integers(0, 9))
def test_text_round_trip_with_room_left(text: str, room: int) -> None:
    length = len(text.encode()) + room
    data = EALData(CHAR, text, length, is_ptr=True)

    assert (data.length, len(data.payload), rebuilt(data).value) == (length, length, text)


@given(st.integers(-(2**63), 2**64 - 1) | st.floats() | st.booleans() | TEXTS | st.binary() | st.none())
def test_round_trip_of_what_of_infers(value: Any) -> None:
    data = EALData.of(value)

    assert rebuilt(data) == data
    assert repr(rebuilt(data).value) == repr(value)  # tells -0.0 from 0.0, and holds for NaN


PUBLIC = (
    *("type", "payload", "length", "is_ptr", "is_unsigned", "is_short", "is_long"),
    *("unit", "frame_id", "stamp_s", "shape", "dtype", "value", "other"),
)


@pytest.mark.parametrize("name", PUBLIC)
def test_nothing_can_be_set(name: str) -> None:
    data = EALData.of(1)

    with pytest.raises(AttributeError):
        setattr(data, name, 2)
    with pytest.raises(AttributeError):
        delattr(data, name)


def test_list_value_is_the_reader_s_own() -> None:
    given_list = [1, 2]
    data = EALData.of(given_list)
    given_list[0] = 9
    data.value[1] = 9

    assert data.value == [1, 2]


def test_equal_means_same_description_and_same_bytes() -> None:
    assert EALData.of(math.nan) == EALData.of(math.nan)
    assert EALData.of(1) == EALData(INT, 1)
    for one, other in [
        (EALData.of(1), EALData.of(2)),
        (EALData.of(1), EALData(INT, 1, is_long=True)),
        (EALData(INT, 1), EALData(INT, 1, is_unsigned=True)),
        (EALData.of(1), EALData.of([1])),
        (EALData.of(0.0), EALData.of(-0.0)),
        (EALData.of(1, unit="m"), EALData.of(1)),
        (EALData.of(1, frame_id="a"), EALData.of(1, frame_id="b")),
        (EALData.of(1, stamp_s=1), EALData.of(1, stamp_s=2)),
        (EALData(CHAR, "a", 1, is_ptr=True), EALData(CHAR, "a", 2, is_ptr=True)),
        (EALData.of(np.zeros((2, 3))), EALData.of(np.zeros((3, 2)))),
        (EALData.of(np.zeros(2)), EALData.of([0.0, 0.0])),
    ]:
        assert one != other
    assert EALData.of(1) != 1


def test_data_is_not_hashable() -> None:
    with pytest.raises(TypeError, match="unhashable"):
        hash(EALData.of(1))


@pytest.mark.parametrize(
    ("data", "shown"),
    [
        (EALData.of(42), "EALData(int 42)"),
        (EALData(CHAR, "s"), "EALData(char 's')"),
        (EALData.of(1.5, unit="m", frame_id="base", stamp_s=2), "unit='m', frame_id='base', stamp_s=2.0)"),
        (EALData(CHAR, "hello", 10, is_ptr=True), "EALData(char[10] 'hello')"),
        (EALData.of([1, 2]), "EALData(int[2] [1, 2])"),
        (EALData.of(list(range(100))), "EALData(int[100] [0, 1, 2, 3, 4, 5, ...])"),
        (EALData.of(b"abc"), "EALData(void[3] b'abc')"),
        (EALData.of(None), "EALData(void None)"),
        (EALData.of(np.zeros((480, 640, 3), np.uint8)), "EALData(unsigned char[921600] shape=(480, 640, 3))"),
    ],
)
def test_repr_tells_the_c_type(data: EALData, shown: str) -> None:
    assert repr(data).endswith(shown)


@pytest.mark.parametrize(
    "value",
    ["x" * 2**20, bytes(2**20), [0.1] * 2**17, np.zeros((1024, 1024), np.uint8)],
    ids=["text", "bytes", "list", "frame"],
)
def test_repr_of_a_megabyte_is_short(value: Any) -> None:
    data = EALData.of(value, unit="x" * 2**20)

    assert data.length == 2**20
    assert len(repr(data)) < 250
    assert len(repr(rebuilt(data))) < 250


@pytest.mark.parametrize(
    "value",
    ["x" * 2**20, bytes(2**20), [[0]] * 2**17, np.zeros(2**20), 10**5000],
    ids=["text", "bytes", "list", "frame", "int"],
)
def test_message_about_a_megabyte_is_short(value: Any) -> None:
    with pytest.raises(DataError) as caught:
        EALData(BOOL, value)

    assert len(str(caught.value)) < 250


WITHOUT_NUMPY = """
import sys
sys.modules["numpy"] = None
from eal_actors.data import DataType, EALData
from eal_actors.errors import DataError

for value in (True, 42, 2**40, 1.5, "hello", b"raw", None, [1, 2], [0.5, 1.0], [True]):
    data = EALData.of(value)
    assert data.value == value
    assert EALData.from_payload(
        data.type, data.payload, is_ptr=data.is_ptr, is_long=data.is_long
    ).value == value
assert EALData(DataType.CHAR, "s").payload == b"s"

frame = EALData.from_payload(DataType.FLOAT, b"abcd", is_ptr=True, shape=(1, 1), dtype="<f4")
assert (frame.payload, frame.shape) == (b"abcd", (1, 1))
try:
    frame.value
except DataError as error:
    assert "needs numpy" in str(error)
else:
    raise AssertionError("a numpy array without numpy")
print("served")
"""


def test_scalars_text_and_bytes_need_no_numpy() -> None:
    done = subprocess.run([sys.executable, "-c", WITHOUT_NUMPY], capture_output=True, text=True, timeout=60)

    assert (done.stdout, done.stderr) == ("served\n", "")


def test_import_leaves_numpy_alone() -> None:
    code = "import sys, eal_actors.data as data; data.EALData.of([1]).value; print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)

    assert (done.stdout, done.stderr) == ("False\n", "")
