"""Payloads are laid out as in C, and read back as what they were."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eal_actors.device.data import DataType, EALData
from tests.unit.device.data.rig import (
    BOOL,
    CHAR,
    DOUBLE,
    FLOAT,
    INT,
    LONG,
    PTR,
    SHORT,
    TEXTS,
    UNSIGNED,
    VOID,
    modifiers_of,
    rebuilt,
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


INTEGERS = {
    (): (-(2**31), 2**31 - 1),
    ("is_unsigned",): (0, 2**32 - 1),
    ("is_short",): (-(2**15), 2**15 - 1),
    ("is_short", "is_unsigned"): (0, 2**16 - 1),
    ("is_long",): (-(2**63), 2**63 - 1),
    ("is_long", "is_unsigned"): (0, 2**64 - 1),
}

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
