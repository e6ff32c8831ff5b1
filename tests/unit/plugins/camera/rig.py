"""Sources of pictures that a test holds in its hand, and the plugin's resource on them."""

from __future__ import annotations

import contextlib
import http.server
import queue
import threading
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from eal_actors.kernel.clock import Clock, SystemClock
from eal_actors.plugin import FleetServices, PluginContext
from plugins.camera import plugin
from plugins.camera.camera import Camera
from plugins.camera.capture import Capture, Image
from plugins.camera.reader import SourceReader

PATIENCE_S: Final = 60.0
"""Real seconds after which a test gives up: more than a busy machine ever takes."""

_STRIPES: Final = 4


def picture(number: int) -> Image:
    """Return a picture, blue first, that shows a number in grey stripes, robust against JPEG."""
    image = np.zeros((48, 64, 3), np.uint8)
    for stripe in range(_STRIPES):
        image[:, stripe * 16 : stripe * 16 + 16] = 16 * (number >> 4 * stripe & 15) + 8
    return image


def number_in(image: Any) -> int:
    """Return the number that a picture shows."""
    return sum(int(image[24, stripe * 16 + 8, 0]) // 16 << 4 * stripe for stripe in range(_STRIPES))


def write_folder(folder: Path, numbers: range) -> Path:
    """Write an image for each number, named by it."""
    folder.mkdir(exist_ok=True)
    for number in numbers:
        cv2.imwrite(str(folder / f"shot{number}.png"), picture(number))
    return folder


def write_video(path: Path, count: int, fps: float) -> Path:
    """Write a video whose pictures show 0 to `count` - 1."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), fps, (64, 48))
    for number in range(count):
        writer.write(picture(number))
    writer.release()
    return path


@contextlib.contextmanager
def camera_on(settings: Mapping[str, Any], clock: Clock | None = None) -> Iterator[Camera]:
    """Have the plugin make and open its resource, and close it in the end."""
    checked = plugin.Settings.model_validate(settings)
    context = PluginContext("rob", "camera", checked, FleetServices(clock or SystemClock()))
    connected = plugin.connect(context)
    camera: Any = connected.makers["Camera"]()
    camera.name = "Camera"
    camera.open()
    try:
        yield camera
    finally:
        camera.close()
        plugin.disconnect(connected)


def run(result: Any) -> Any:
    """Return what a call gives, at once or by an activity."""
    if not isinstance(result, types.GeneratorType):
        return result
    while True:
        try:
            next(result)
        except StopIteration as end:
            return end.value


def wait_until_ready(reader: SourceReader) -> None:
    """Wait until a reader has pictures again."""
    with reader._changed:
        assert reader._changed.wait_for(lambda: reader._why_not_ready() is None, PATIENCE_S), reader._why_not_ready()


def wait_until_shown(reader: SourceReader, number: int) -> None:
    """Wait until a reader's newest picture shows a number."""

    def is_shown() -> bool:
        return reader._frame is not None and number_in(reader._frame.image) == number

    with reader._changed:
        assert reader._changed.wait_for(is_shown, PATIENCE_S)


class MjpegServer:
    """A network camera: motion JPEG over HTTP, which can be stalled, stuck, unplugged and plugged in again."""

    def __init__(self, fps: float = 50.0) -> None:
        self.port = 0
        self._fps = fps
        self._numbers = iter(range(1 << 4 * _STRIPES))
        self._moves = threading.Event()
        self._moves.set()
        self._flows = threading.Event()
        self._flows.set()
        self._unplugged = threading.Event()
        self._sending = threading.Lock()
        self.sent = -1
        """The number that was sent last."""
        self.plug_in()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/video.mjpg"

    def plug_in(self) -> None:
        """Serve, on the same port as before."""
        self._unplugged.clear()
        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", self.port), self._handler())
        self._server.daemon_threads = False
        self.port = self._server.server_port
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02})
        self._thread.start()

    def unplug(self) -> None:
        """End the connections, and take no more."""
        self._unplugged.set()
        self._flows.set()
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    def stall(self, *, stalled: bool) -> None:
        """Hold the connections open and send nothing; returns when nothing is being sent."""
        with self._sending:
            (self._flows.clear if stalled else self._flows.set)()

    def stick(self, *, stuck: bool) -> None:
        """Send the same picture again and again."""
        (self._moves.clear if stuck else self._moves.set)()

    def __enter__(self) -> MjpegServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    def _handler(self) -> type[http.server.BaseHTTPRequestHandler]:
        camera = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(200)
                self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
                self.end_headers()
                with contextlib.suppress(OSError):  # nobody watches any more
                    camera._send(self.wfile)

            def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
                """Keep quiet."""

        return Handler

    def _send(self, out: Any) -> None:
        number = next(self._numbers)
        while not self._unplugged.wait(1 / self._fps):
            with self._sending:
                if not self._flows.is_set():
                    continue
                if self._moves.is_set():
                    number = next(self._numbers)
                data = cv2.imencode(".jpg", picture(number))[1].tobytes()
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                out.write(head.encode() + data + b"\r\n")
                self.sent = number


class CrankedCapture(Capture):
    """A capture that delivers what a test gives it, when the test gives it: a picture, or what reading raises."""

    period_s: float | None = None

    def __init__(self) -> None:
        self.given: queue.Queue[Image | Exception] = queue.Queue()
        self.adjusted: list[dict[str, float]] = []
        self.refuses: list[str] = []
        self.is_read = threading.Semaphore(0)
        """Released each time that a reading begins."""
        self.released = threading.Semaphore(0)

    def read(self) -> Image:
        self.is_read.release()
        given = self.given.get(timeout=PATIENCE_S)
        if isinstance(given, Exception):
            raise given
        return given

    def mode(self) -> dict[str, float]:
        asked = [wishes for wishes in self.adjusted if not self.refuses]
        return dict(item for wishes in [{"exposure": 1.0}, *asked] for item in wishes.items())

    def adjust(self, wishes: Mapping[str, float]) -> list[str]:
        self.adjusted.append(dict(wishes))
        return self.refuses

    def release(self) -> None:
        self.released.release()
