"""Representation, equality and immutability of data."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from eal_actors.device.data import EALData
from eal_actors.kernel.errors import DataError
from tests.unit.device.data.rig import (
    CHAR,
    INT,
    rebuilt,
)

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


def test_data_is_not_hashable() -> None:
    with pytest.raises(TypeError, match="unhashable"):
        hash(EALData.of(1))


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


@pytest.mark.parametrize("value", [True, False, 0, 0.5, "", None, [1.0, 2.0]])
def test_data_is_neither_true_nor_false(value: object) -> None:
    """`if eal.get_value(bump):` would be true for every value."""
    with pytest.raises(TypeError, match=r"EALData\(.*\) is neither true nor false; its `value` may be"):
        bool(EALData.of(value))


@pytest.mark.parametrize("value", [1, 1.0, True, "a"])
def test_data_is_not_compared_with_a_plain_value(value: object) -> None:
    """`if eal.get_value(light) == 1.0:` was false for every value."""
    data = EALData.of(value)
    with pytest.raises(TypeError, match=r"EALData\(.*\) is never equal to .*; its `value` may be"):
        assert data == value
    with pytest.raises(TypeError, match="is never equal to"):
        assert value != data
    assert data != None  # noqa: E711
