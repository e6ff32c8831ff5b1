"""A network camera: RTSP, or any HTTP stream that FFmpeg reads, such as MJPEG."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
from typing_extensions import override

from .capture import LiveCapture, fps_of, refuse_all, size_of


def open_stream(url: str, timeout_s: float) -> NetworkStream:
    """Connect to a stream; the time-out is that of the connection and of each picture, in real seconds.

    Raises:
        OSError: no readable stream answers in time.
    """
    limit_ms = round(timeout_s * 1000)
    limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, limit_ms, cv2.CAP_PROP_READ_TIMEOUT_MSEC, limit_ms]
    capture = cv2.VideoCapture(url, cv2.CAP_FFMPEG, limits)
    if not capture.isOpened():
        capture.release()
        raise OSError(f"no stream that FFmpeg can read answers within {timeout_s:g} s")
    return NetworkStream(capture)


class NetworkStream(LiveCapture):
    """An open stream. The sender determines its size and rate."""

    lost = "the stream has ended or timed out"

    @override
    def mode(self) -> dict[str, float]:
        return {**fps_of(self._capture), "exposure": 1.0}

    @override
    def adjust(self, wishes: Mapping[str, float]) -> list[str]:
        return refuse_all("stream", {**size_of(self._capture), **self.mode()}, wishes)
