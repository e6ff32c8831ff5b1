"""EALData.of finds the type of a value, or says that none fits."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eal_actors.device.data import DataType, EALData
from eal_actors.kernel.errors import DataError
from tests.unit.device.data.rig import (
    BOOL,
    CHAR,
    DOUBLE,
    INT,
    LONG,
    PTR,
    TEXTS,
    UNSIGNED,
    VOID,
    modifiers_of,
    rebuilt,
)

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


@given(st.integers(-(2**63), 2**64 - 1) | st.floats() | st.booleans() | TEXTS | st.binary() | st.none())
def test_round_trip_of_what_of_infers(value: Any) -> None:
    data = EALData.of(value)

    assert rebuilt(data) == data
    assert repr(rebuilt(data).value) == repr(value)  # tells -0.0 from 0.0, and holds for NaN
