"""Cameras: the newest frame of each watched camera, as a JPEG."""

from __future__ import annotations

import threading
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, TypeAlias

from eal_actors.actors.streams import Stream
from eal_actors.device.data import EALData
from eal_actors.device.data.images import encode_image
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.errors import ArgumentError, EALError, UnsupportedError, error_text
from eal_actors.operate.dashboard.limits import MAX_FRAMES_PER_S

CameraKey: TypeAlias = tuple[str, str]
"""A robot and its resource."""

MAX_OPEN: Final = 16
"""Cameras that all browsers together may watch."""
_RETRY_S: Final = 0.5  # real seconds from a failure to the next attempt


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """The newest frame of a camera.

    Attributes:
        number: counts frames and failures.
        jpeg: the picture; empty before the first.
        stamp_s: when it was taken, by the fleet's clock; None before the first.
        same_since_s: the start of the series of identical pictures, by the fleet's clock.
        error: why there is no newer frame; None if there is.
    """

    number: int = 0
    jpeg: bytes = b""
    stamp_s: float | None = None
    same_since_s: float | None = None
    error: str | None = None


class Cameras:
    """Opens a camera for the first browser that watches it, and closes it after the last. Thread: any.

    `on_frame` is called for each new frame or failure, and must not block.
    """

    def __init__(self, fleet: Fleet, on_frame: Callable[[], None]) -> None:
        self._fleet = fleet
        self._on_frame = on_frame
        self._lock = threading.Lock()
        self._open: dict[CameraKey, _CameraReader] = {}
        self._watched: dict[object, tuple[frozenset[CameraKey], float]] = {}
        self._closing: list[_CameraReader] = []
        self._is_closed = False

    def watch(self, browser: object, keys: Iterable[CameraKey], rate_hz: float) -> None:
        """Choose the cameras of a browser, in place of its previous ones.

        Raises ArgumentError if there is no such robot or resource, or too many cameras are watched.
        """
        wanted = frozenset(keys)
        for robot, resource in wanted:
            if robot not in self._fleet or resource not in self._fleet[robot]:
                raise ArgumentError(f"there is no camera {robot}/{resource}")
        with self._lock:
            if self._is_closed:
                return
            others = {key for other, (keys_, _) in self._watched.items() if other is not browser for key in keys_}
            if len(others | wanted) > MAX_OPEN:
                raise ArgumentError(f"all browsers together watch at most {MAX_OPEN} cameras")
            if wanted:
                self._watched[browser] = (wanted, rate_hz)
            else:
                self._watched.pop(browser, None)
            self._open_and_close()

    def leave(self, browser: object) -> None:
        """Forget a browser."""
        self.watch(browser, (), MAX_FRAMES_PER_S)

    def frame(self, key: CameraKey) -> CameraFrame | None:
        """Return the newest frame of a watched camera."""
        camera = self._open.get(key)
        return camera.frame if camera is not None else None

    def close(self) -> None:
        """Close every camera. Thread: blocks until their threads have ended."""
        with self._lock:
            self._is_closed = True
            self._watched.clear()
            self._open_and_close()
            closing, self._closing = self._closing, []
        for camera in closing:
            camera.thread.join()

    def _open_and_close(self) -> None:
        """Open the cameras that are watched, each at the highest rate that is asked for, and close the others."""
        rates: dict[CameraKey, float] = {}
        for keys, rate_hz in self._watched.values():
            for key in keys:
                rates[key] = max(rates.get(key, 0.0), rate_hz)
        for key in [key for key, camera in self._open.items() if rates.get(key) != camera.rate_hz]:
            camera = self._open.pop(key)
            camera.end()
            self._closing.append(camera)
        self._closing = [camera for camera in self._closing if camera.thread.is_alive()]
        for key, rate_hz in rates.items():
            if key not in self._open:
                self._open[key] = _CameraReader(self._fleet, key, rate_hz, self._on_frame)


class _CameraReader:
    """Reads one camera in its own thread."""

    def __init__(self, fleet: Fleet, key: CameraKey, rate_hz: float, on_frame: Callable[[], None]) -> None:
        self.rate_hz = rate_hz
        self.frame = CameraFrame()
        self._clock = fleet.clock
        self._resource = fleet[key[0]][key[1]]
        self._on_frame = on_frame
        self._is_over = False
        self._stop = new_waiter()
        self._stream: Stream | None = None
        self._checksum: int | None = None
        self.thread = threading.Thread(target=self._read, name=f"dashboard camera {'/'.join(key)}", daemon=True)
        self.thread.start()

    def end(self) -> None:
        self._is_over = True
        REAL_TIME.wake(self._stop)
        if (stream := self._stream) is not None:
            stream.close()

    def _read(self) -> None:
        while not self._is_over:
            try:
                self._read_stream()
            except (ArgumentError, UnsupportedError) as error:  # not a camera, or OpenCV is missing
                self._fail(error)
                return
            except EALError as error:
                if not self._is_over:
                    self._fail(error)
                    REAL_TIME.wait(self._stop, _RETRY_S)

    def _read_stream(self) -> None:
        rate_hz = self.rate_hz / self._clock.of_real(1.0)  # streams count seconds of the fleet's clock
        with self._resource.stream(rate_hz, "jpeg") as stream:
            self._stream = stream
            if self._is_over:  # `end` came before there was a stream to close
                return
            for data in stream:
                self._publish(data)

    def _publish(self, data: EALData) -> None:
        stamp_s = data.stamp_s if data.stamp_s is not None else self._clock.now()
        if stamp_s == self.frame.stamp_s and self.frame.error is None:
            return  # the same picture again, by its own time stamp
        jpeg = encode_image(data, "jpeg")
        checksum = zlib.crc32(jpeg)
        is_same = checksum == self._checksum and self.frame.same_since_s is not None
        self._checksum = checksum
        since_s = self.frame.same_since_s if is_same else stamp_s
        self.frame = CameraFrame(self.frame.number + 1, jpeg, stamp_s, since_s)
        self._on_frame()

    def _fail(self, error: EALError) -> None:
        last = self.frame
        text = error.message or error_text(error)
        self.frame = CameraFrame(last.number + 1, last.jpeg, last.stamp_s, last.same_since_s, text)
        self._on_frame()
