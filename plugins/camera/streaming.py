"""Simulated cameras as network cameras, for `eal lab`: MJPEG over HTTP."""

from __future__ import annotations

from typing import Any, Final

import cv2

from eal_actors.plugin import Clock, PluginContext

_PERIOD_S: Final = 0.5
_QUALITY: Final = 95  # of 100; the grain of 75 costs accuracy
_HEAD: Final = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n"
_PART: Final = b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%b\r\n"


class PictureStream:
    """The server of a camera's pictures, two a second, from a client's request until it hangs up.

    Args:
        most_age_s: age of a picture, on a busy machine, from which it is made anew: a client believes that it is new.
    """

    def __init__(self, camera: Any, clock: Clock, most_age_s: float = _PERIOD_S) -> None:
        self._camera = camera
        self._most_age_s = most_age_s
        self._clock = clock
        camera.frame()  # the first one takes seconds
        self._next_s: float | None = None

    def connected(self) -> None:
        """Wait for the request of a new client."""
        self._next_s = None

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Return the bytes of the next picture when it is due. Any request asks for the stream."""
        reply = b""
        if data and self._next_s is None:
            reply, self._next_s = _HEAD, now_s
        if self._next_s is None or now_s < self._next_s:
            return reply
        picture, stamp_s = self._camera.frame()
        _, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        if self._clock.now() > stamp_s + self._most_age_s:
            return reply
        self._next_s = now_s + _PERIOD_S
        return reply + _PART % (jpeg.size, jpeg.tobytes())


def emulate_in_world(context: PluginContext, url: str) -> PictureStream:
    """Return the server of a robot's simulated camera."""
    return PictureStream(context.simulated_camera(url), context.clock)
