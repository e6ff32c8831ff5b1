"""Pictures as PNG files, for notebooks, without an image library (Source: W3C, PNG, third edition)."""

from __future__ import annotations

import struct
import zlib
from typing import Final

from eal_actors.device.data.c_types import CType, DataType

_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_COLOURS: Final = {1: 0, 3: 2}  # the colour type of PNG by the number of channels: grey, RGB
_MAX_SIDE: Final = 16_384


def is_picture(c_type: CType, shape: tuple[int, ...] | None) -> bool:
    """Return whether a value is a picture: bytes in rows and columns, grey or RGB."""
    if c_type.type is not DataType.CHAR or not c_type.is_unsigned or shape is None or len(shape) not in (2, 3):
        return False
    return all(0 < side <= _MAX_SIDE for side in shape[:2]) and shape[2:] in ((), (1,), (3,))


def picture_png(pixels: bytes | memoryview, shape: tuple[int, ...] | None, level: int = 1) -> bytes:
    """Return a picture, rows from the top, as a PNG file; its shape is rows, columns, and channels unless grey.

    `level` is that of zlib, from 0 for no compression to 9.
    """
    assert shape is not None  # noqa: S101  # `is_picture`
    rows, columns, channels = (*shape, 1)[:3]
    content, width = bytes(pixels), columns * channels
    lines = b"".join(b"\0" + content[row * width : (row + 1) * width] for row in range(rows))
    header = struct.pack(">IIBBBBB", columns, rows, 8, _COLOURS[channels], 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(lines, level)), (b"IEND", b""))
    return _SIGNATURE + b"".join(map(_chunk, *zip(*chunks, strict=True)))


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
