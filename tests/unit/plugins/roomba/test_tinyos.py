"""plugins/roomba: TinyOS frames and packets, against the protocol's own bytes, and against any bytes."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eal_actors.kernel.errors import ArgumentError, DataError
from plugins.roomba.tinyos import Ack, Header, Packet, TinyosFraming, crc, frame

WANTING_ACK = bytes.fromhex("7e 44 26 00 ff ff 00 00 04 22 89 7d 5e 7d 5d 01 02 31 3c 7e")
ACK = bytes.fromhex("7e 43 26 3b 1c 7e")
FORMS = [
    TinyosFraming(),
    TinyosFraming(Header.TINYOS_1),
    TinyosFraming(ack_byte=1, reliable_byte=0x7E, plain_byte=0x7D, am_type=6),
]

payloads = st.binary(max_size=28)


def bodies(framing: TinyosFraming, data: bytes) -> list[bytes]:
    return framing.deframer().feed(data)


def test_the_crc_is_that_of_the_document() -> None:
    assert crc(b"123456789") == 0x31C3


def test_the_protocol_page_s_packet_and_its_acknowledgement() -> None:
    framing = TinyosFraming()
    assert framing.packet(bytes.fromhex("7e 7d 01 02"), 0x26) == WANTING_ACK
    assert framing.ack(0x26) == ACK
    (body,) = bodies(framing, WANTING_ACK)
    assert framing.read(body) == Packet(bytes.fromhex("7e 7d 01 02"), 0x26, 0x89, 0x22, 0xFFFF)
    (body,) = bodies(framing, ACK)
    assert framing.read(body) == Ack(0x26)


def test_a_packet_of_tinyos_2_that_wants_no_acknowledgement_has_no_sequence_byte() -> None:
    body = bytes.fromhex("45 00 ff ff 00 00 01 22 89 ab")
    assert bodies(TinyosFraming(), TinyosFraming().packet(b"\xab", None)) == [body]
    assert TinyosFraming().read(body) == Packet(b"\xab", None, 0x89, 0x22, 0xFFFF)


def test_a_packet_of_tinyos_1_has_its_own_bytes_and_header() -> None:
    framing = TinyosFraming(Header.TINYOS_1, destination=0x0102)
    (body,) = bodies(framing, framing.packet(b"\xab", 7))
    assert body == bytes.fromhex("41 07 02 01 89 22 01 ab")
    assert framing.read(body) == Packet(b"\xab", 7, 0x89, 0x22, 0x0102)
    (body,) = bodies(framing, framing.packet(b"\xab", None))
    assert body == bytes.fromhex("42 02 01 89 22 01 ab")
    assert bodies(framing, framing.ack(7)) == [bytes.fromhex("40 07")]


def test_protocol_bytes_that_cannot_be_told_apart_are_refused() -> None:
    with pytest.raises(ArgumentError, match="three protocol bytes must differ, not 0x44, 0x44, 0x45"):
        TinyosFraming(ack_byte=0x44)


def test_a_payload_that_is_too_long_is_refused() -> None:
    with pytest.raises(ArgumentError, match="28 bytes at most, not 29"):
        TinyosFraming().packet(bytes(29), None)
    assert TinyosFraming(payload_bytes=29).packet(bytes(29), None)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("", "no frame begins with nothing"),
        ("ff 01", "no frame begins with ff 01"),
        ("43", "an acknowledgement has 2 bytes, not 1"),
        ("43 01 02", "an acknowledgement has 2 bytes, not 3"),
        ("44", "no frame begins with 44"),
        ("45 00 ff ff", "header has 8 bytes, not 3"),
        ("45 01 ff ff 00 00 00 22 89", "dispatch byte 1 is no active message"),
        ("45 00 ff ff 00 00 02 22 89 01", "says it carries 2 bytes, and has 1"),
    ],
)
def test_what_is_no_packet_is_named(body: str, words: str) -> None:
    with pytest.raises(DataError, match=words):
        TinyosFraming().read(bytes.fromhex(body))


def test_one_flag_may_stand_between_two_frames() -> None:
    assert len(bodies(TinyosFraming(), ACK + ACK[1:])) == 2


def test_a_frame_cut_in_an_escape_is_dropped_and_the_next_one_read() -> None:
    deframer = TinyosFraming().deframer()
    assert deframer.feed(WANTING_ACK[:12] + ACK) == [ACK[1:3]]
    assert deframer.dropped == 1


def test_a_frame_without_end_is_dropped_once_and_not_kept() -> None:
    deframer = TinyosFraming().deframer()
    assert deframer.feed(b"\x7e" + bytes(100_000) + ACK) == [ACK[1:3]]
    assert deframer.dropped == 1


@pytest.mark.parametrize("framing", FORMS)
@given(payload=payloads, sequence=st.none() | st.integers(0, 255))
def test_packets_come_back(framing: TinyosFraming, payload: bytes, sequence: int | None) -> None:
    (body,) = bodies(framing, framing.packet(payload, sequence))
    packet = framing.read(body)
    assert isinstance(packet, Packet)
    assert (packet.payload, packet.sequence) == (payload, sequence)
    assert framing.is_ours(packet)


@pytest.mark.parametrize("framing", FORMS)
@given(data=st.binary(max_size=200))
def test_any_bytes_never_crash_a_decoder(framing: TinyosFraming, data: bytes) -> None:
    for body in [data, *bodies(framing, data), *bodies(framing, frame(data))]:
        try:
            framing.read(body)
        except DataError:
            continue


@given(
    garbage=st.lists(st.binary(max_size=30), min_size=1, max_size=6),
    sent=st.lists(payloads, min_size=1, max_size=6),
    cuts=st.lists(st.integers(1, 9), min_size=1),
)
def test_after_garbage_whole_frames_are_read_however_they_are_cut(
    garbage: list[bytes], sent: list[bytes], cuts: list[int]
) -> None:
    framing, data = TinyosFraming(), b""
    for number, (payload, noise) in enumerate(itertools.zip_longest(sent, garbage[: len(sent)], fillvalue=b"")):
        data += noise + b"\x7e" + framing.packet(payload, number)  # a flag ends whatever the noise began
    deframer, found, sizes = framing.deframer(), list[bytes](), itertools.cycle(cuts)
    while data:
        size = next(sizes)
        found += deframer.feed(data[:size])
        data = data[size:]
    read = []
    for body in found:
        try:
            packet = framing.read(body)
        except DataError:  # noise may be a frame, with luck
            continue
        if isinstance(packet, Packet) and packet.sequence is not None:
            read.append((packet.sequence, packet.payload))
    assert [entry for entry in read if entry in list(enumerate(sent))] == list(enumerate(sent))


@given(payload=payloads, place=st.integers(0, 10_000), bit=st.integers(0, 7))
def test_one_flipped_bit_never_yields_a_packet(payload: bytes, place: int, bit: int) -> None:
    framing = TinyosFraming()
    data = bytearray(framing.packet(payload, 3))
    data[place % len(data)] ^= 1 << bit
    for body in bodies(framing, bytes(data)):
        assert framing.read(body) == Packet(payload, 3, 0x89, 0x22, 0xFFFF)  # a lost flag at the rim costs nothing
