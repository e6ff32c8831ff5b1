"""The data of the thesis's programs: the examples of section B.1.2."""

from __future__ import annotations

from typing import Any

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


@pytest.mark.parametrize("length", [-1, 2**62])
@pytest.mark.parametrize("data", [0, b"a", "a"])
def test_a_length_that_no_int_of_c_has_is_refused(length: int, data: Any) -> None:
    value = EALDataInfo_t(CHAR, data, length, ISPTR)
    with pytest.raises(DataError, match=f"length must be a number of bytes from 0 to 2147483647, not {length}"):
        value.__eal_data__()


def test_a_length_that_no_int_of_c_has_is_refused_by_a_read() -> None:
    value = EALDataInfo_t(INT, 0, 2**62, ISPTR)
    with pytest.raises(DataError, match="length must be a number of bytes"):
        value.fill(bytes(4))
