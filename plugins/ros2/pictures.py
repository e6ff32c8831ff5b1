"""Pictures in ROS 2 messages, as RGB arrays."""

from __future__ import annotations

import io
from typing import Any, Final

import numpy as np

from eal_actors.plugin import DataError, UnsupportedError

_MOST_PIXELS: Final = 50_000_000
_CHANNELS: Final = {
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
    "mono8": (1, (0, 0, 0)),
    "8UC1": (1, (0, 0, 0)),
    "8UC3": (3, (2, 1, 0)),
}
"""Bytes of a pixel, and which of them are red, green and blue, by the encoding."""


def decode_image(message: Any) -> Any:
    """Return the picture of a sensor_msgs/msg/Image, shape (height, width, 3).

    Raises:
        DataError: its encoding is another one, or its bytes do not fit its size.
    """
    if message.encoding not in _CHANNELS:
        raise DataError(f"a picture in {message.encoding!r}; known encodings are {', '.join(_CHANNELS)}")
    channels, order = _CHANNELS[message.encoding]
    height, width, step = int(message.height), int(message.width), int(message.step)
    if not height * width or step < width * channels or len(message.data) < height * step:
        raise DataError(f"a picture of {width} x {height} with {len(message.data)} bytes in rows of {step}")
    rows = np.asarray(message.data, np.uint8)[: height * step].reshape(height, step)
    return np.ascontiguousarray(rows[:, : width * channels].reshape(height, width, channels)[:, :, list(order)])


def decode_compressed(message: Any) -> Any:
    """Return the picture of a sensor_msgs/msg/CompressedImage, shape (height, width, 3).

    Raises:
        DataError: it is no picture, or too large.
        UnsupportedError: Pillow is not installed.
    """
    try:
        from PIL import Image
    except ImportError as error:
        raise UnsupportedError(f"compressed pictures need Pillow ({error}): pip install 'eal-actors[sim]'") from None
    try:
        with Image.open(io.BytesIO(bytes(message.data))) as picture:
            if picture.width * picture.height > _MOST_PIXELS:
                raise DataError(f"a picture of {picture.width} x {picture.height}, over {_MOST_PIXELS} pixels")
            return np.asarray(picture.convert("RGB"))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise DataError(f"{len(message.data)} bytes in {message.format!r} are no picture: {error}") from None
