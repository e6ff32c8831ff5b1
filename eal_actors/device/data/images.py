"""Images as JPEG or PNG files, by OpenCV.

OpenCV is imported on first use, since small boards run without it. It allocates the image size that a file declares,
so the declared size is checked here before OpenCV sees the file.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, get_args

from eal_actors.device.data.storage import Payload
from eal_actors.device.data.value import EALData
from eal_actors.kernel.errors import ProtocolError, ResourceFaultError, UnsupportedError

if TYPE_CHECKING:
    import numpy as np

Encoding: TypeAlias = Literal["raw", "jpeg", "png"]
"""The encoding of a frame on the network. JPEG loses a little, the others nothing. The reader gets an image again."""

ENCODINGS: Final[tuple[str, ...]] = get_args(Encoding)

_JPEG_QUALITY: Final = 90
_PNG_LEVEL: Final = 1
"""From 0 to 9; higher levels take several times as long and save a few per cent."""
_PNG_BEGINS: Final = b"\x89PNG\r\n\x1a\n"
_PNG_CHUNK: Final = struct.Struct(">I4s")
_JPEG_SIZES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers of the segments that contain a JPEG's size."""


def require_codec(encoding: Encoding) -> None:
    """Raise UnsupportedError, which names the extra to install, if an encoding needs OpenCV and it is missing.

    Thread: any; the first call may take a second.
    """
    if encoding != "raw":
        _opencv(encoding)


def _opencv(encoding: str) -> Any:
    try:
        import cv2
    except ImportError as error:
        message = f"frames as {encoding} need OpenCV; install eal-actors[vision] there, or ask for 'raw' frames"
        raise UnsupportedError(message) from error
    return cv2


def encode_image(data: EALData, encoding: Encoding) -> bytes:
    """Return an image, uint8 of shape (height, width, 3) with red first, as a JPEG or PNG file.

    Raises UnsupportedError if OpenCV is not installed, and ResourceFaultError if it cannot encode the image, such as a
    JPEG with more than 65,500 rows.
    """
    cv2 = _opencv(encoding)
    if encoding == "jpeg":
        suffix, parameters = ".jpg", [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    else:
        suffix, parameters = ".png", [cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL]
    try:
        is_done, file = cv2.imencode(suffix, cv2.cvtColor(data.value, cv2.COLOR_RGB2BGR), parameters)
    except cv2.error as error:
        raise ResourceFaultError(f"an image of shape {data.shape} cannot be encoded as {encoding}: {error}") from error
    if not is_done:
        raise ResourceFaultError(f"an image of shape {data.shape} cannot be encoded as {encoding}")
    return bytes(memoryview(file))


def decode_image(file: Payload, shape: tuple[int, ...], encoding: Encoding) -> memoryview:
    """Return the bytes of the image in a JPEG or PNG file, row by row, red first.

    Raises UnsupportedError if OpenCV is not installed, and ProtocolError if the file is invalid or has another shape.
    """
    cv2 = _opencv(encoding)
    import numpy as np

    size = _png_size(file) if encoding == "png" else _jpeg_size(file)
    found = None if size is None else (*size, 3)
    if size == shape[:2]:
        try:
            image: np.ndarray[Any, Any] | None = cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_COLOR_RGB)
        except cv2.error as error:
            raise ProtocolError(f"a frame is no {encoding} image: {error}") from error
        if image is not None and image.shape == shape:
            return memoryview(image.data).cast("B")
        found = None if image is None else image.shape
    what = "cannot be read" if found is None else f"has the shape {found}"
    raise ProtocolError(f"a frame as {encoding}, of shape {shape} by its header, {what}")


def _png_size(file: Payload) -> tuple[int, int] | None:
    """Return the height and width that a PNG file declares; None if it is invalid or truncated."""
    if bytes(file[:8]) != _PNG_BEGINS or len(file) < 45:
        return None
    (length, kind), (width, height) = _PNG_CHUNK.unpack_from(file, 8), struct.unpack_from(">II", file, 16)
    if kind != b"IHDR":
        return None
    place = 8
    while place + 12 <= len(file):
        length, kind = _PNG_CHUNK.unpack_from(file, place)
        place += 12 + length
    return (height, width) if place == len(file) and kind == b"IEND" else None


def _jpeg_size(file: Payload) -> tuple[int, int] | None:
    """Return the height and width that a JPEG file declares; None if it is invalid."""
    if bytes(file[:2]) != b"\xff\xd8":
        return None
    place = 2
    while place + 9 <= len(file):
        start, marker, length = struct.unpack_from(">BBH", file, place)
        if start != 0xFF or length < 2:
            return None
        if marker in _JPEG_SIZES:
            height, width = struct.unpack_from(">HH", file, place + 5)
            return height, width
        place += 2 + length
    return None
