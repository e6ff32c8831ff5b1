"""A network camera: RTSP, or MJPEG and whatever else FFmpeg reads over HTTP."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

from .capture import Image, fps_of, refuse_all


def open_stream(url: str, name: str, timeout_s: float) -> Stream:
    """Connect to a stream.

    Args:
        url: its URL.
        name: what messages call it, without a password.
        timeout_s: real seconds that connecting and each picture may take.

    Raises:
        OSError: nothing that can be read answers in time.
    """
    limit_ms = round(timeout_s * 1000)
    limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, limit_ms, cv2.CAP_PROP_READ_TIMEOUT_MSEC, limit_ms]
    capture = cv2.VideoCapture(url, cv2.CAP_FFMPEG, limits)
    if not capture.isOpened():
        capture.release()
        raise OSError(f"nothing that FFmpeg can read answers there within {timeout_s:g} s")
    return Stream(capture, name)


class Stream:
    """An open stream; see Capture. Its size and rate are the sender's.

    Args:
        capture: an open `cv2.VideoCapture`.
        name: what messages call it.
    """

    period_s: float | None = None

    def __init__(self, capture: Any, name: str) -> None:
        self._capture = capture
        self._name = name

    def read(self) -> Image:
        """See Capture."""
        is_read, image = self._capture.read()
        if not is_read:
            raise OSError("the stream has ended, or fell silent")
        return np.asarray(image, np.uint8)

    def mode(self) -> dict[str, float]:
        """See Capture."""
        return {**fps_of(self._capture), "exposure": 1.0}

    def adjust(self, wishes: Mapping[str, float]) -> list[str]:
        """See Capture."""
        size = {
            "width": self._capture.get(cv2.CAP_PROP_FRAME_WIDTH),
            "height": self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT),
        }
        return refuse_all("stream", {**size, **self.mode()}, wishes)

    def release(self) -> None:
        """See Capture."""
        self._capture.release()
