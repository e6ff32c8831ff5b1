"""Values, types and payloads that do not fit are refused, with the reason."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from eal_actors.device.data import DataType, EALData
from eal_actors.kernel.errors import DataError
from tests.unit.device.data import rig

NO_VALUES = [
    (rig.INT, 2**31, {}, None, "int: 2147483648 is not an int in -2147483648..2147483647"),
    (rig.INT, -(2**31) - 1, {}, None, "int: -2147483649 is not"),
    (rig.INT, 2**32, rig.UNSIGNED, None, "unsigned int: 4294967296 is not an int in 0..4294967295"),
    (rig.INT, -1, rig.UNSIGNED, None, "unsigned int: -1 is not"),
    (rig.INT, 2**15, rig.SHORT, None, "short: 32768 is not an int in -32768..32767"),
    (rig.INT, 2**16, rig.SHORT | rig.UNSIGNED, None, "unsigned short: 65536 is not an int in 0..65535"),
    (rig.INT, 2**63, rig.LONG, None, "long: 9223372036854775808 is not"),
    (rig.INT, 2**64, rig.LONG | rig.UNSIGNED, None, "unsigned long: 18446744073709551616 is not"),
    pytest.param(rig.INT, 10**5000, {}, None, "int: <int of 16610 bits> is not", id="an int too long for str()"),
    (rig.INT, math.nan, {}, None, "int: nan is not an int"),
    (rig.INT, 3.0, {}, None, "int: 3.0 is not an int"),
    (rig.INT, True, {}, None, "int: True is not an int"),
    (rig.INT, "3", {}, None, "int: '3' is not an int"),
    (rig.INT, None, {}, None, "int: None is not an int"),
    (rig.INT, [1], {}, None, r"int: \[1\] is not an int"),
    (rig.INT, 1, rig.PTR, None, r"int\[\]: 1 is no list or tuple or numpy array of dtype <i4"),
    (rig.INT, [1, 2, 2**31], rig.PTR, None, r"int\[2\]: 2147483648 is not an int in"),
    (rig.INT, [1, True], rig.PTR, None, r"int\[1\]: True is not an int"),
    (rig.INT, [1, 2.0], rig.PTR, None, r"int\[1\]: 2.0 is not an int"),
    (rig.INT, [1, None], rig.PTR, None, r"int\[1\]: None is not an int"),
    (rig.CHAR, 300, {}, None, "char: 300 is not one ASCII character or its code, an int in 0..127"),
    (rig.CHAR, -1, {}, None, "char: -1 is not"),
    (rig.CHAR, "é", {}, None, "char: 'é' is not one ASCII character"),
    (rig.CHAR, "no", {}, None, "char: 'no' is not one ASCII character .* need is_ptr=True"),
    (rig.CHAR, "", {}, None, "char: '' is not one ASCII character"),
    (rig.CHAR, True, {}, None, "char: True is not"),
    (rig.CHAR, 256, rig.UNSIGNED, None, "unsigned char: 256 is not an int in 0..255"),
    (rig.CHAR, "s", rig.UNSIGNED, None, "unsigned char: 's' is not an int in 0..255"),
    (rig.CHAR, b"hello", rig.PTR, None, r"char\[\]: b'hello' is no str"),
    (rig.CHAR, [104], rig.PTR, None, r"char\[\]: \[104\] is no str"),
    (rig.CHAR, "a\0b", rig.PTR, None, r"char\[\]: 'a\\x00b' holds a zero character"),
    (rig.CHAR, "\ud800", rig.PTR, None, "is no UTF-8 text: surrogates not allowed"),
    (rig.FLOAT, 1e39, {}, None, "float: 1e[+]39 is not a float or int up to 3.4e38"),
    (rig.FLOAT, [0.0, -1e39], rig.PTR, None, r"float\[1\]: -1e[+]39 is not"),
    (rig.FLOAT, True, {}, None, "float: True is not"),
    (rig.DOUBLE, 10**400, {}, None, "double: <int of 1329 bits> is not"),
    (rig.DOUBLE, "1.5", {}, None, "double: '1.5' is not"),
    (rig.DOUBLE, None, {}, None, "double: None is not"),
    (rig.BOOL, 1, {}, None, "bool: 1 is not True or False"),
    (rig.BOOL, [True, 0], rig.PTR, None, r"bool\[1\]: 0 is not True or False"),
    (rig.VOID, 1, {}, None, "void: 1 is not None"),
    (rig.VOID, b"abc", {}, None, "void: b'abc' is not None; bytes need is_ptr=True"),
    (rig.VOID, None, rig.PTR, None, r"void\[\]: None is no bytes"),
    (rig.VOID, "abc", rig.PTR, None, r"void\[\]: 'abc' is no bytes"),
    (rig.INT, 42, {}, 0, "length: this int takes 4 bytes, not 0"),
    (rig.INT, 42, {}, 8, "length: this int takes 4 bytes, not 8; is_long=True makes an int 8 bytes"),
    (rig.INT, 42, rig.LONG, 4, "length: this long takes 8 bytes, not 4"),
    (rig.INT, [1, 2], rig.PTR, 12, r"length: this int\[\] takes 8 bytes, not 12"),
    (rig.CHAR, "hello", rig.PTR, 4, "length: the text takes 5 bytes, more than 4"),
    (rig.CHAR, "éé", rig.PTR, 3, "length: the text takes 4 bytes, more than 3"),
    (rig.VOID, None, {}, 1, "length: this void takes 0 bytes, not 1"),
    (rig.INT, 42, {}, -4, "length: -4 is no number of bytes"),
    (rig.INT, 42, {}, 4.0, "length: 4.0 is no number of bytes"),
    (rig.BOOL, True, {}, True, "length: True is no number of bytes"),
]


@pytest.mark.parametrize(("kind", "value", "modifiers", "length", "message"), NO_VALUES)
def test_value_that_does_not_fit_is_refused(
    kind: DataType, value: Any, modifiers: dict[str, Any], length: Any, message: str
) -> None:
    with pytest.raises(DataError, match=message):
        EALData(kind, value, length, **modifiers)


NO_TYPES = [
    (rig.INT, rig.SHORT | rig.LONG, "no short long int here, only int, unsigned int, short,"),
    (rig.CHAR, rig.LONG, "no long char here, only char, unsigned char$"),
    (rig.CHAR, rig.SHORT, "no short char"),
    (rig.CHAR, rig.UNSIGNED | rig.LONG, "no unsigned long char"),
    (rig.FLOAT, rig.UNSIGNED, "no unsigned float here, only float$"),
    (rig.FLOAT, rig.LONG, "no long float"),
    (rig.DOUBLE, rig.UNSIGNED, "no unsigned double here, only double$"),
    (rig.DOUBLE, rig.SHORT, "no short double"),
    (rig.DOUBLE, rig.LONG, "no long double here, only double; long double has no size common to all machines"),
    (rig.BOOL, rig.UNSIGNED, "no unsigned bool"),
    (rig.VOID, rig.LONG, "no long void"),
    ("INT", {}, "type: 'INT' is no DataType; there are INT, CHAR, FLOAT, DOUBLE, BOOL, VOID"),
    (None, {}, "type: None is no DataType"),
    ([], {}, r"type: \[\] is no DataType"),
    (rig.INT, {"is_short": "yes"}, "is_short: 'yes' is no bool"),
    (rig.INT, {"is_long": []}, r"is_long: \[\] is no bool"),
]


@pytest.mark.parametrize(("kind", "modifiers", "message"), NO_TYPES)
def test_contradiction_is_refused_whatever_the_value(kind: Any, modifiers: dict[str, Any], message: str) -> None:
    for is_ptr in (False, True):
        with pytest.raises(DataError, match=message):
            EALData(kind, 1, is_ptr=is_ptr, **modifiers)
        with pytest.raises(DataError, match=message):
            EALData.from_payload(kind, b"\1", is_ptr=is_ptr, **modifiers)


NO_PAYLOADS = [
    (rig.INT, b"\0\0\0", {}, "payload: int takes 4 bytes, not 3"),
    (rig.INT, bytes(4), rig.LONG, "payload: long takes 8 bytes, not 4"),
    (rig.INT, bytes(6), rig.PTR, "payload: 6 bytes are no whole number of int, 4 bytes each"),
    (rig.CHAR, b"\x80", {}, "char: 128 is not one ASCII character"),
    (rig.CHAR, b"ab\xff", rig.PTR, "payload: no UTF-8 text at byte 2"),
    (rig.BOOL, b"\2", {}, "payload: a bool is 0 or 1"),
    (rig.BOOL, b"\1\0\2\0", rig.PTR, "payload: a bool is 0 or 1"),
    (rig.BOOL, b"\1\0\2\0", rig.PTR | {"shape": (4,), "dtype": "|b1"}, "payload: a bool is 0 or 1"),
    (rig.VOID, b"a", {}, "payload: void takes 0 bytes, not 1"),
    (rig.VOID, "text", rig.PTR, "payload: 'text' is no bytes, bytearray or memoryview"),
    (rig.VOID, memoryview(b"abcd")[::2], rig.PTR, "payload: the memoryview is not contiguous"),
    (rig.INT, bytes(8), rig.PTR | {"shape": (2,)}, r"shape \(2,\) and dtype None must be given together"),
    (rig.INT, bytes(8), rig.PTR | {"dtype": "<i4"}, "shape None and dtype '<i4' must be given together"),
    (
        rig.INT,
        bytes(8),
        rig.PTR | {"shape": (2,), "dtype": "<f4"},
        r"dtype: '<f4' does not fit int\[\], which takes <i4",
    ),
    (rig.INT, bytes(8), rig.PTR | {"shape": (2,), "dtype": ">i4"}, "dtype: '>i4' does not fit"),
    (rig.INT, bytes(4), {"shape": (), "dtype": "<i4"}, "dtype: '<i4' does not fit int, which takes no numpy array"),
    (
        rig.INT,
        bytes(8),
        rig.PTR | {"shape": (3,), "dtype": "<i4"},
        r"shape: \(3,\) of 4 bytes each does not fit 8 bytes",
    ),
    (rig.INT, bytes(8), rig.PTR | {"shape": (-1, -2), "dtype": "<i4"}, "holds what is no size"),
    (rig.INT, bytes(8), rig.PTR | {"shape": (2.0,), "dtype": "<i4"}, "holds what is no size"),
    (rig.INT, bytes(8), rig.PTR | {"shape": 2, "dtype": "<i4"}, "shape: 2 is no list of at most 32 sizes"),
    (rig.INT, b"", rig.PTR | {"shape": (0, 2**62, 2**62), "dtype": "<i4"}, "too large for an array"),
    (rig.INT, bytes(4), rig.PTR | {"shape": (1,) * 33, "dtype": "<i4"}, "no list of at most 32 sizes"),
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
        EALData(rig.BOOL, value)

    assert len(str(caught.value)) < 250
