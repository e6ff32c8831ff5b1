"""plugins/roomba: sensor packets and the stream, against the document's bytes, and against any bytes."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eal_actors.kernel.errors import DataError
from plugins.roomba import packets
from plugins.roomba.packets import FORMS, GROUPS, StreamReader, decode, encode, packets_of, size_of, stream_frame

EXAMPLE = bytes([19, 5, 29, 2, 25, 13, 0, 163])
"""The document's, checksum and all."""

values_of_packets = st.dictionaries(st.sampled_from(sorted(FORMS)), st.integers(-40000, 70000), min_size=1, max_size=20)


def test_the_document_s_frame() -> None:
    assert stream_frame({29: 537, 13: 0}) == EXAMPLE
    assert StreamReader().feed(EXAMPLE) == [{29: 537, 13: 0}]


@pytest.mark.parametrize(
    ("group", "size"),
    [(0, 26), (1, 10), (2, 6), (3, 10), (4, 14), (5, 12), (6, 52), (100, 80), (101, 28), (106, 12), (107, 9)],
)
def test_the_groups_have_the_document_s_sizes(group: int, size: int) -> None:
    assert sum(size_of(packet) for packet in GROUPS[group]) == size


@pytest.mark.parametrize(
    ("packet", "data", "value"),
    [
        (packets.CURRENT, b"\xff\x38", -200),
        (packets.VOLTAGE, b"\x3e\xe4", 16100),
        (packets.TEMPERATURE, b"\xfb", -5),
        (packets.LEFT_COUNTS, b"\xff\xff", 65535),
        (packets.REQUESTED_LEFT, b"\xff\xff", -1),
        (packets.OI_MODE, b"\x02", 2),
    ],
)
def test_packets_on_the_wire(packet: int, data: bytes, value: int) -> None:
    assert encode(packet, value) == data
    assert decode([packet], data) == {packet: value}


def test_what_does_not_fit_a_packet_is_brought_to_the_nearest_that_does() -> None:
    assert [encode(packets.TEMPERATURE, 200), encode(packets.VOLTAGE, -1)] == [b"\x7f", b"\x00\x00"]


def test_what_is_no_packet_is_refused() -> None:
    with pytest.raises(DataError, match="OI: there is no sensor packet 59"):
        packets_of(59)
    with pytest.raises(DataError, match="these 2 packets have 3 bytes, not 2"):
        decode([7, 22], b"ab")


@given(data=st.binary(max_size=300), sizes=st.lists(st.integers(1, 20), min_size=1))
def test_any_bytes_never_crash_the_reader_and_a_frame_after_them_is_read(data: bytes, sizes: list[int]) -> None:
    reader, rest, cuts = StreamReader(), data, itertools.cycle(sizes)
    while rest:
        size = next(cuts)
        reader.feed(rest[:size])
        rest = rest[size:]
    found = reader.feed(bytes(260) + EXAMPLE)  # what the noise began is at an end after 258 bytes
    assert found[-1] == {29: 537, 13: 0}


def test_a_false_header_does_not_hold_the_next_frame_back() -> None:
    assert StreamReader((29, 13)).feed(bytes([19, 255]) + EXAMPLE) == [{29: 537, 13: 0}]


@given(st.lists(values_of_packets, min_size=1, max_size=5), st.integers(1, 30))
def test_frames_come_back_however_they_are_cut_and_glued(frames: list[dict[int, int]], size: int) -> None:
    data = b"".join(stream_frame(values) for values in frames)
    reader, found = StreamReader(), []
    for start in range(0, len(data), size):
        found += reader.feed(data[start : start + size])
    expected = [
        {packet: decode([packet], encode(packet, value))[packet] for packet, value in frame.items()} for frame in frames
    ]
    assert found == expected
    assert reader.skipped == 0


@given(values=values_of_packets, place=st.integers(0, 10_000), bit=st.integers(0, 7))
def test_a_flipped_bit_never_passes(values: dict[int, int], place: int, bit: int) -> None:
    frame = bytearray(stream_frame(values))
    frame[place % len(frame)] ^= 1 << bit
    assert sum(frame) % 256
    assert not any(found.keys() == values.keys() for found in StreamReader().feed(bytes(frame)))
