"""Arrays cross without a copy; without numpy everything else still works."""

from __future__ import annotations

import struct
import subprocess
import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from eal_actors.device.data import DataType, EALData
from eal_actors.kernel.errors import DataError
from tests.unit.device.data import rig

NUMPY_TYPES = [
    ("|u1", rig.CHAR, rig.UNSIGNED, "01ff", [1, 255]),
    ("<i2", rig.INT, rig.SHORT, "01000080", [1, -(2**15)]),
    ("<i4", rig.INT, {}, "0100000000000080", [1, -(2**31)]),
    ("<i8", rig.INT, rig.LONG, "01000000000000000000000000000080", [1, -(2**63)]),
    ("<f4", rig.FLOAT, {}, "0000803f0000c0bf", [1.0, -1.5]),
    ("<f8", rig.DOUBLE, {}, "000000000000f03f000000000000f8bf", [1.0, -1.5]),
    ("|b1", rig.BOOL, {}, "0100", [True, False]),
]


@pytest.mark.parametrize(("dtype", "kind", "modifiers", "layout", "values"), NUMPY_TYPES)
def test_numpy_array_crosses_without_a_copy(
    dtype: str, kind: DataType, modifiers: dict[str, Any], layout: str, values: list[Any]
) -> None:
    array = np.array([values], dtype)
    data = EALData.of(array)

    assert (data.type, rig.modifiers_of(data), data.shape, data.dtype) == (kind, modifiers | rig.PTR, (1, 2), dtype)
    assert bytes(data.payload) == bytes.fromhex(layout)
    assert data.length == len(layout) // 2
    assert np.shares_memory(data.value, array)
    assert np.shares_memory(np.frombuffer(data.payload, np.uint8), array)
    assert data == EALData(kind, array, **modifiers, is_ptr=True)

    received = rig.rebuilt(data, data.payload)
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
        assert (data.type, rig.modifiers_of(data), data.shape, data.dtype) == (kind, modifiers, None, None)
        assert data.value == values[1]
        assert type(data.value) is type(values[1])
        assert bytes(data.payload) == bytes.fromhex(layout)[len(layout) // 4 :]


def test_list_of_numpy_scalars_is_a_list_of_numbers() -> None:
    assert EALData.of(list(np.arange(3))).value == [0, 1, 2]
    assert EALData(rig.FLOAT, [np.float64(0.5), 1], is_ptr=True).value == [0.5, 1.0]


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
        (rig.DOUBLE, rig.PTR, r"double\[\]: given a numpy array of dtype <f4, takes an array of dtype <f8"),
        (rig.FLOAT, {}, "float: given a numpy array of dtype <f4, takes no numpy array; arrays need is_ptr=True"),
        (rig.VOID, rig.PTR, r"void\[\]: given a numpy array of dtype <f4, takes no numpy array"),
        (
            rig.INT,
            rig.PTR | rig.UNSIGNED,
            r"unsigned int\[\]: given a numpy array of dtype <f4, takes an array of dtype <u4",
        ),
    ],
)
def test_numpy_array_of_another_type_is_refused(kind: DataType, modifiers: dict[str, Any], message: str) -> None:
    with pytest.raises(DataError, match=message):
        EALData(kind, np.zeros(2, np.float32), **modifiers)


class _Subclass(np.ndarray[Any, Any]):
    """An array of another library."""


@pytest.mark.parametrize(
    "view",
    [
        np.arange(6)[::-1],
        np.arange(12)[::2],
        np.arange(12, dtype=np.uint8)[::-1],
        np.arange(24, dtype=np.uint8).reshape(2, 4, 3)[..., ::-1],
        np.arange(12.0).reshape(3, 4)[:, ::-1],
        np.arange(12.0).reshape(3, 4)[1:, 1:3],
        np.broadcast_to(np.float32(2), (2, 3)),
        np.arange(4).reshape(2, 2)[::-1].view(_Subclass),
        np.zeros((0, 3))[::-1],
    ],
    ids=lambda view: f"{view.dtype}{view.shape}{view.strides}",
)
def test_views_of_other_arrays_have_their_own_elements_as_bytes(view: Any) -> None:
    data = EALData.of(view)
    plain = np.array(view, order="C", subok=False)

    assert type(data.value) is np.ndarray
    assert bytes(data.payload) == plain.tobytes()
    assert memoryview(data.payload).c_contiguous
    assert memoryview(data.payload).readonly
    assert np.array_equal(rig.rebuilt(data, data.payload).value, plain)


def test_masked_array_is_refused_because_its_mask_would_be_lost() -> None:
    with pytest.raises(DataError, match=r"a masked numpy array has no type; .*array\.filled"):
        EALData.of(np.ma.array([1, 2], mask=[False, True]))


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
    data = EALData.from_payload(rig.FLOAT, buffer, is_ptr=True, shape=[1], dtype="<f4")

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
    np.testing.assert_array_equal(rig.rebuilt(data).value, array, strict=True)


WITHOUT_NUMPY = """
import sys
sys.modules["numpy"] = None
from eal_actors.device.data import DataType, EALData
from eal_actors.kernel.errors import DataError

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
    code = "import sys, eal_actors.device.data as data; data.EALData.of([1]).value; print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)

    assert (done.stdout, done.stderr) == ("False\n", "")


def test_values_are_made_while_another_thread_imports_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    """The half-imported module lacks `ndarray`: a twist of the dashboard failed, and ended its page's connection."""
    monkeypatch.setitem(sys.modules, "numpy", ModuleType("numpy"))
    assert EALData.of([0.5, 0.0]).payload == struct.pack("<2d", 0.5, 0.0)
