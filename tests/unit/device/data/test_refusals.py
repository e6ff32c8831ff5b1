"""Values, types and payloads that do not fit are refused, with the reason."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from eal_actors.device.data import DataType, EALData
from eal_actors.kernel.errors import DataError
from tests.unit.device.data.rig import BOOL, CHAR, DOUBLE, FLOAT, INT, LONG, PTR, SHORT, UNSIGNED, VOID

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


@pytest.mark.parametrize(
    "value",
    ["x" * 2**20, bytes(2**20), [[0]] * 2**17, np.zeros(2**20), 10**5000],
    ids=["text", "bytes", "list", "frame", "int"],
)
def test_message_about_a_megabyte_is_short(value: Any) -> None:
    with pytest.raises(DataError) as caught:
        EALData(BOOL, value)

    assert len(str(caught.value)) < 250
