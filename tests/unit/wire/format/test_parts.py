"""Parts: what is split is put together, other bytes are refused, and no certificate takes the room of another one."""

from __future__ import annotations

import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eal_actors.kernel.errors import BusyError, ProtocolError
from eal_actors.wire.format import parts
from eal_actors.wire.format.batches import MAX_ROWS, encode_batch
from eal_actors.wire.format.messages import CallHeader, encode_call
from eal_actors.wire.format.packing import PROTOCOL_VERSION, pack
from tests.manual_clock import ManualClock

SECRET = "0" * 32
ANNA, BERT, ANYBODY = (f"eal/f/r1/Eye/set_value/{name}/{SECRET}" for name in ("anna", "bert", "_"))
HALF = parts.MAX_BYTES // 2


def first_part(number: int, total: int) -> tuple[bytes, bytes]:
    return pack((PROTOCOL_VERSION, number, 0, total, 0), "part"), bytes(10)


def envelope_of(number: int, text: str = "") -> bytes:
    return encode_call(CallHeader(SECRET, 1, number, 60.0, 60.0, None, (text,)))[0]


@given(st.text(max_size=500), st.integers(parts.PART_BYTES, 3 * parts.PART_BYTES))
def test_a_call_arrives_as_it_was(text: str, length: int) -> None:
    store, payload = parts.PartStore(), (bytes(range(251)) * (length // 251 + 1))[:length]
    envelope = envelope_of(123_456, text)
    messages = list(parts.split(envelope, payload))
    assert all(row[:1] == parts.BEGINS_PART and len(content) <= parts.PART_BYTES for row, content in messages)
    assert {parts.number_of(row) for row, _ in messages} == {123_456}  # by which a refused call is answered
    *before, whole = [store.add(ANNA, *message) for message in messages]
    assert before == [None] * len(before)
    assert whole == (envelope, payload)
    assert store.held_bytes == 0


def test_a_batch_with_long_names_arrives_as_it_was() -> None:
    store, rows = parts.PartStore(), [("r" * 64, "Eye", "get_value", envelope_of(7), bytes(64))] * MAX_ROWS
    messages = list(parts.split(encode_batch(rows), b""))
    assert {parts.number_of(row) for row, _ in messages} == {0}
    assert [store.add(ANNA, *message) for message in messages] == [None, (encode_batch(rows), b"")]


def test_a_small_call_is_one_message() -> None:
    envelope, payload = b"a", bytes(parts.PART_BYTES - 1)
    assert list(parts.split(envelope, payload)) == [(envelope, payload)]


def test_calls_may_be_interleaved() -> None:
    store, (one, two) = parts.PartStore(), (bytes([number]) * 100_000 for number in (1, 2))
    rows = zip(parts.split(envelope_of(1), one), parts.split(envelope_of(2), two), strict=True)
    answers = [store.add(ANNA, *message) for pair in rows for message in pair]
    assert [answer for answer in answers if answer] == [(envelope_of(1), one), (envelope_of(2), two)]


@pytest.mark.parametrize(
    ("row", "payload"),
    [
        ((PROTOCOL_VERSION, 0, 0, parts.MAX_BYTES + 1, 0), b"x"),
        ((PROTOCOL_VERSION, 0, 0, 10, 11), b"x"),
        ((PROTOCOL_VERSION, 0, 0, 10, 1), b""),
        ((PROTOCOL_VERSION, 0, 0, 10, 1), bytes(11)),
        ((PROTOCOL_VERSION, 0, 11, 10, 1), b"x"),
        ((PROTOCOL_VERSION, 0, -1, 10, 1), b"x"),
        ((PROTOCOL_VERSION, 0, 0.0, 10, 1), b"x"),
        ((PROTOCOL_VERSION, None, 0, 10, 1), b"x"),
        ((2, 0, 0, 10, 1), b"x"),
        ((PROTOCOL_VERSION, 0, 0, 10), b"x"),
    ],
)
def test_what_is_no_part_is_refused(row: tuple[object, ...], payload: bytes) -> None:
    with pytest.raises(ProtocolError):
        parts.PartStore().add(ANNA, pack(row, "part"), payload)


def test_a_part_out_of_order_ends_its_call() -> None:
    store = parts.PartStore()
    first, second, third = parts.split(envelope_of(1), bytes(3 * parts.PART_BYTES - 100))
    assert [store.add(ANNA, *part) for part in (first, third, second, third)] == [None] * 4
    assert store.held_bytes == 0


def test_one_certificate_takes_no_room_of_another() -> None:
    store = parts.PartStore()
    for number in (1, 2):
        assert store.add(ANNA, *first_part(number, HALF)) is None
    with pytest.raises(BusyError):
        store.add(ANNA, *first_part(3, HALF))
    assert store.add(BERT, *first_part(3, parts.MAX_BYTES)) is None
    assert store.held_bytes <= parts.MAX_TOTAL_BYTES
    with pytest.raises(BusyError):
        store.add(ANYBODY, *first_part(4, HALF))


def test_without_certificates_all_share_the_whole_room() -> None:
    store = parts.PartStore()
    for number in range(4):
        assert store.add(ANYBODY, *first_part(number, HALF)) is None
    with pytest.raises(BusyError):
        store.add(ANYBODY, *first_part(5, HALF))


def test_calls_that_are_never_complete_are_forgotten() -> None:
    clock = ManualClock()
    store = parts.PartStore(clock)
    store.add(ANNA, *first_part(1, parts.MAX_BYTES))
    clock.advance(parts.MAX_AGE_S)
    store.add(ANNA, *first_part(2, parts.MAX_BYTES))
    assert store.held_bytes == parts.MAX_BYTES


def test_tiny_calls_that_never_end_are_few() -> None:
    store = parts.PartStore()
    most = parts.MAX_BYTES // parts.PART_BYTES
    for number in range(most):
        assert store.add(ANNA, pack((PROTOCOL_VERSION, number, 0, 2, 0), "part"), b"x") is None
    with pytest.raises(BusyError):
        store.add(ANNA, pack((PROTOCOL_VERSION, most, 0, 2, 0), "part"), b"x")
    assert store.add(BERT, pack((PROTOCOL_VERSION, 0, 0, 2, 0), "part"), b"x") is None


def test_who_only_begins_the_largest_calls_makes_no_buffers_for_them() -> None:
    store = parts.PartStore()
    tracemalloc.start()
    try:
        for number in range(100):
            store.add(ANNA, *first_part(number, parts.MAX_BYTES))
            store.add(ANNA, pack((PROTOCOL_VERSION, number, 7, parts.MAX_BYTES, 0), "part"), b"x")  # not the next one
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 1024**2
