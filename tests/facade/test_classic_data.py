"""The data of the thesis's programs: the examples of section B.1.2."""

from __future__ import annotations

import pytest

from eal_actors.classic import (
    BOOL,
    CHAR,
    DOUBLE,
    FLOAT,
    INT,
    ISLONG,
    ISPTR,
    ISSHORT,
    ISUNSIGNED,
    VOID,
    EALData_t,
    EALDataInfo_t,
    EALDataType_t,
)
from eal_actors.kernel.errors import DataError


def test_data_of_base_types() -> None:
    number = EALDataInfo_t(INT)
    number.data = 42
    letter = EALDataInfo_t(CHAR)
    letter.data = "s"
    assert bytes(number.__eal_data__().payload) == b"\x2a\0\0\0"
    assert bytes(letter.__eal_data__().payload) == b"s"


def test_data_of_arrays_and_text() -> None:
    numbers = EALDataInfo_t(INT, [0] * 10, 4 * 10, ISPTR)
    for i in range(10):
        numbers.data[i] = i
    text = EALDataInfo_t(CHAR, "", 10, ISPTR)
    text.data = "hello"
    assert bytes(numbers.__eal_data__().payload) == b"".join(bytes([i, 0, 0, 0]) for i in range(10))
    assert bytes(text.__eal_data__().payload) == b"hello\0\0\0\0\0"


def test_a_long_integer_in_both_ways() -> None:
    first = EALDataInfo_t(INT, 0, 8, not ISPTR, not ISUNSIGNED, not ISSHORT, ISLONG)
    first.data = 1000000
    second = EALDataInfo_t(INT, 0, 8)
    second.isLong = True
    second.data = 1000000
    assert first == second
    assert bytes(second.__eal_data__().payload) == b"\x40\x42\x0f\0\0\0\0\0"


def test_constructor_defaults_are_those_of_the_thesis() -> None:
    assert EALDataInfo_t() == EALDataInfo_t(INT, 0, 0, False, False, False, False)
    assert EALData_t is EALDataInfo_t
    assert {INT, CHAR, FLOAT, DOUBLE, BOOL, VOID} == set(EALDataType_t)


def test_a_length_below_zero_is_refused() -> None:
    with pytest.raises(DataError, match="length must be a number of bytes from 0, not -1"):
        EALDataInfo_t(INT, 0, -1).__eal_data__()
