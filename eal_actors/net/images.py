"""Frames as JPEG or PNG: smaller on their way, and images again at the other end.

OpenCV does it, and is imported when it is needed first: small boards do without.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from eal_actors.actors.feeds import Encoding
from eal_actors.data import EALData, Payload
from eal_actors.errors import ProtocolError, ResourceFaultError, UnsupportedError

if TYPE_CHECKING:
    import numpy as np

_JPEG_QUALITY: Final = 90
_PNG_LEVEL: Final = 1
"""Of 0 to 9: the higher ones take several times as long to save a few per cent."""


def require_codec(encoding: Encoding) -> None:
    """Raise UnsupportedError, which names the extra, where an encoding needs OpenCV and that is not installed.

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
    """Return an image as a JPEG or PNG file.

    Args:
        data: uint8 of shape (height, width, 3), red first.
        encoding: `jpeg` or `png`.

    Raises:
        UnsupportedError: OpenCV is not installed.
        ResourceFaultError: OpenCV cannot encode it, such as a JPEG with more than 65,500 rows.
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

    Raises:
        UnsupportedError: OpenCV is not installed.
        ProtocolError: it is no such file, or the image has another shape.
    """
    cv2 = _opencv(encoding)
    import numpy as np

    try:
        image: np.ndarray[Any, Any] | None = cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_COLOR_RGB)
    except cv2.error as error:
        raise ProtocolError(f"a frame is no {encoding} image: {error}") from error
    if image is None or image.shape != shape:
        found = "cannot be read" if image is None else f"has the shape {image.shape}"
        raise ProtocolError(f"a frame as {encoding}, of shape {shape} by its header, {found}")
    return memoryview(image.data).cast("B")
