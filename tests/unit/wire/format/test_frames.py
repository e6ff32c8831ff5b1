from __future__ import annotations

import sys

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eal_actors.actors.feeds import StreamSpec
from eal_actors.device.data import EALData
from eal_actors.device.data.images import Encoding, require_codec
from eal_actors.kernel.errors import (
    ArgumentError,
    DataError,
    EALError,
    ProtocolError,
    UnavailableError,
    UnsupportedError,
)
from eal_actors.wire.format.frames import (
    StreamFrame,
    decode_frame,
    encode_frame,
    parse_stream_request,
    shared_place,
    stream_request,
)
from eal_actors.wire.format.messages import RobotTime
from eal_actors.wire.format.packing import MAX_PAYLOAD_BYTES, PROTOCOL_VERSION
from eal_actors.wire.shared_memory import SharedValue

TIME = RobotTime("e", 2.0)
GRADIENT = np.dstack([np.tile(np.arange(64, dtype=np.uint8) * 3, (48, 1)) + shift for shift in (0, 20, 40)])


def test_a_raw_frame_as_bytes() -> None:
    # Written by hand after the table of docs/reference/wire-format.md and the msgpack specification.
    envelope = bytes.fromhex(
        "97 04 01 95 a5 666c6f6174 c0 c0 c0 cb3ff8000000000000 a1 65 cb4000000000000000 cb3fe0000000000000 a3 726177"
    )
    frame = StreamFrame(EALData.from_payload(EALData.of(0.5).type, b"\0" * 8).with_meta(stamp_s=1.5), TIME, 0.5)
    del frame
    data = decode_frame(envelope, bytes.fromhex("0000003f")).content
    assert isinstance(data, EALData)
    assert (data.value, data.stamp_s) == (0.5, 1.5)
    assert encode_frame(StreamFrame(data, TIME, 0.5), "raw") == (envelope, bytes.fromhex("0000003f"))


@pytest.mark.parametrize(("encoding", "is_exact"), [("raw", True), ("png", True), ("jpeg", False)])
def test_images_arrive_as_images(encoding: Encoding, is_exact: bool) -> None:
    data = EALData.of(GRADIENT, frame_id="cam", stamp_s=1.0)
    envelope, payload = encode_frame(StreamFrame(data, TIME, 0.25), encoding)
    frame = decode_frame(envelope, payload)
    assert isinstance(frame.content, EALData)
    assert (frame.time, frame.age_s, frame.content.frame_id) == (TIME, 0.25, "cam")
    difference = np.abs(frame.content.value.astype(int) - GRADIENT)
    assert difference.max() == 0 if is_exact else difference.max() < 12
    if encoding != "raw":
        assert len(payload) < data.length / 2
        assert bytes(payload[:3]) == (b"\x89PN" if encoding == "png" else b"\xff\xd8\xff")


def test_each_reader_finds_its_place_in_shared_memory() -> None:
    data = EALData.of(GRADIENT)
    places: list[tuple[str, SharedValue | None]] = [("01" * 16, SharedValue(7, 0, 1, 9216)), ("02" * 16, None)]
    envelope, payload = encode_frame(StreamFrame(data, TIME), "raw", lambda _: places)
    assert payload == data.payload  # the second reader needs it
    assert [shared_place(envelope, client) for client, _ in places] == [places[0][1], None]
    envelope, payload = encode_frame(StreamFrame(data, TIME), "raw", lambda _: places[:1])
    assert payload == b""
    assert decode_frame(envelope, data.payload).content == data
    with pytest.raises(UnavailableError, match="for the readers before this one"):  # which a stream waits out
        decode_frame(envelope, payload)
    for damage in ([[b"short", 1, 2, 3, 4]], [[b"1" * 16, 1, 2, 3]], [[b"1" * 16, 1, 2, 3, -4]], [7]):
        with pytest.raises(ProtocolError):
            shared_place(msgpack.packb([PROTOCOL_VERSION, 1, None, "e", 2.0, 0.0, "raw", damage]), "31" * 16)


def test_an_error_arrives_as_itself() -> None:
    envelope, payload = encode_frame(StreamFrame(UnavailableError("restarting", robot="r"), TIME), "jpeg")
    error = decode_frame(envelope, payload).content
    assert isinstance(error, UnavailableError)
    assert str(error) == "r: restarting"


def test_what_is_too_large_is_refused() -> None:
    data = EALData.of(bytes(MAX_PAYLOAD_BYTES + 1))
    with pytest.raises(DataError, match="cannot be streamed, more than the 67108864"):
        encode_frame(StreamFrame(data, TIME), "raw")


@pytest.mark.parametrize("encoding", ["png", "jpeg"])
@pytest.mark.parametrize("damage", [lambda file: b"", lambda file: file[:20], lambda file: b"x" * len(file)])
def test_a_damaged_image_makes_no_sense(encoding: Encoding, damage: object) -> None:
    envelope, payload = encode_frame(StreamFrame(EALData.of(GRADIENT), TIME), encoding)
    with pytest.raises(ProtocolError, match=f"a frame as {encoding}|a frame is no {encoding} image"):
        decode_frame(envelope, damage(bytes(payload)))  # type: ignore[operator]


def test_an_image_of_another_shape_than_its_header_says_makes_no_sense() -> None:
    _, payload = encode_frame(StreamFrame(EALData.of(GRADIENT), TIME), "png")
    envelope, _ = encode_frame(StreamFrame(EALData.of(GRADIENT[1:]), TIME), "png")
    with pytest.raises(ProtocolError, match=r"of shape \(47, 64, 3\) by its header, has the shape \(48, 64, 3\)"):
        decode_frame(envelope, payload)


@given(st.binary(max_size=60), st.binary(max_size=60))
def test_garbage_is_refused(envelope: bytes, payload: bytes) -> None:
    with pytest.raises(ProtocolError):
        decode_frame(envelope, payload)


def test_a_request_reads_back() -> None:
    assert parse_stream_request(stream_request(StreamSpec(29.97, "jpeg"), 3.0)) == (StreamSpec(29.97, "jpeg"), 3.0)
    assert parse_stream_request(("raw", "10", -5)) == (StreamSpec(10.0, "raw"), 0.0)
    assert parse_stream_request(("raw", "10", 10**9))[1] == 10.0


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        pytest.param((), ProtocolError, id="nothing"),
        pytest.param(("raw", 10, 3000), ProtocolError, id="rate no text"),
        pytest.param(("raw", "often", 3000), ProtocolError, id="rate no number"),
        pytest.param(("raw", "nan", 3000), ArgumentError, id="not a number"),
        pytest.param(("raw", "1e9", 3000), ArgumentError, id="too fast"),
        pytest.param(("gif", "10", 3000), ArgumentError, id="encoding"),
    ],
)
def test_a_request_that_makes_no_sense(arguments: tuple[object, ...], error: type[EALError]) -> None:
    with pytest.raises(error):
        parse_stream_request(arguments)


def test_without_opencv_the_error_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    require_codec("raw")
    with pytest.raises(UnsupportedError, match=r"jpeg need OpenCV; install eal-actors\[vision\]"):
        require_codec("jpeg")
