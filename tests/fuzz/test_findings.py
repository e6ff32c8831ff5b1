"""Regression tests of fuzzing: a small file must not cost much memory or time."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from eal_actors.device.data import EALData
from eal_actors.kernel.errors import ProtocolError, UnavailableError
from eal_actors.wire.format.frames import StreamFrame, decode_frame, encode_frame
from eal_actors.wire.format.messages import RobotTime

TIME = RobotTime("8f3a", 2.5)
IMAGE = EALData.of(np.zeros((4, 6, 3), np.uint8))


def sent(encoding: str) -> tuple[bytes, bytes]:
    envelope, payload = encode_frame(StreamFrame(IMAGE, TIME), encoding)  # type: ignore[arg-type]
    return envelope, bytes(payload)


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def test_a_png_that_claims_to_be_huge_is_not_decoded() -> None:
    envelope, file = sent("png")
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 30_000, 30_000, 8, 2, 0, 0, 0))
    with pytest.raises(ProtocolError, match=r"of shape \(4, 6, 3\) by its header, has the shape \(30000, 30000, 3\)"):
        decode_frame(envelope, file[:8] + header + file[33:])


def test_a_png_chunk_beyond_the_end_of_the_file_is_not_read() -> None:
    envelope, file = sent("png")
    with pytest.raises(ProtocolError, match="cannot be read"):
        decode_frame(envelope, file[:33] + b"\x40" + file[34:])


def test_a_jpeg_that_claims_to_be_huge_is_not_decoded() -> None:
    envelope, file = sent("jpeg")
    at = file.index(b"\xff\xc0")
    huge = file[: at + 5] + struct.pack(">HH", 65_000, 65_000) + file[at + 9 :]
    with pytest.raises(ProtocolError, match=r"has the shape \(65000, 65000, 3\)"):
        decode_frame(envelope, huge)


@pytest.mark.parametrize(("told", "is_in"), [("png", "jpeg"), ("jpeg", "png")])
def test_a_file_of_another_kind_than_it_is_told_to_be_is_not_decoded(told: str, is_in: str) -> None:
    with pytest.raises(ProtocolError, match="cannot be read"):
        decode_frame(sent(told)[0], sent(is_in)[1])


def test_what_is_no_bomb_is_decoded() -> None:
    for encoding in ("png", "jpeg"):
        content = decode_frame(*sent(encoding)).content
        assert isinstance(content, EALData)
        assert content.shape == (4, 6, 3)
    envelope, payload = encode_frame(StreamFrame(UnavailableError("away"), TIME), "png")
    assert isinstance(decode_frame(envelope, payload).content, UnavailableError)
