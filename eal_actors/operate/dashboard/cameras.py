"""Cameras: the newest frame of each camera that somebody watches, as a JPEG."""

from __future__ import annotations

import threading
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, TypeAlias

from eal_actors.actors.streams import Stream
from eal_actors.device.data import EALData
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.errors import ArgumentError, EALError, UnsupportedError, error_text
from eal_actors.net.wire.images import encode_image
from eal_actors.operate.dashboard.limits import MAX_FRAMES_PER_S

CameraKey: TypeAlias = tuple[str, str]
"""A robot and its resource."""

MAX_OPEN: Final = 16
"""Cameras that all browsers together may watch."""
_PAUSE_S: Final = 0.5
"""Real seconds after a failure until the camera is asked again."""


@dataclass(frozen=True, slots=True)
class Frame:
    """What a camera showed last.

    Attributes:
        number: counts what came, failures too.
        jpeg: the picture; empty as long as none has come.
        stamp_s: when it was taken, by the fleet's clock; None as long as none has come.
        same_since_s: since when the picture has been the same to the bit, by the fleet's clock.
        error: why there is no newer one; None if there is.
    """

    number: int = 0
    jpeg: bytes = b""
    stamp_s: float | None = None
    same_since_s: float | None = None
    error: str | None = None


class Cameras:
    """Opens a camera when the first browser watches it, and closes it after the last one.

    Args:
        fleet: a connected fleet.
        on_frame: called when there is something new; it must not block.

    Thread: any.
    """

    def __init__(self, fleet: Fleet, on_frame: Callable[[], None]) -> None:
        self._fleet = fleet
        self._on_frame = on_frame
        self._lock = threading.Lock()
        self._open: dict[CameraKey, _Camera] = {}
        self._wishes: dict[object, tuple[frozenset[CameraKey], float]] = {}
        self._leaving: list[_Camera] = []
        self._is_closed = False

    def watch(self, browser: object, keys: Iterable[CameraKey], rate_hz: float) -> None:
        """Have a browser watch these cameras from now on, and no others.

        Raises:
            ArgumentError: a robot or resource that does not exist, or too many cameras for one dashboard.
        """
        wanted = frozenset(keys)
        for robot, resource in wanted:
            if robot not in self._fleet or resource not in self._fleet[robot]:
                raise ArgumentError(f"there is no camera {robot}/{resource}")
        with self._lock:
            if self._is_closed:
                return
            others = {key for other, (keys_, _) in self._wishes.items() if other is not browser for key in keys_}
            if len(others | wanted) > MAX_OPEN:
                raise ArgumentError(f"all browsers together watch at most {MAX_OPEN} cameras")
            if wanted:
                self._wishes[browser] = (wanted, rate_hz)
            else:
                self._wishes.pop(browser, None)
            self._serve_wishes()

    def leave(self, browser: object) -> None:
        """Forget a browser."""
        self.watch(browser, (), MAX_FRAMES_PER_S)

    def frame(self, key: CameraKey) -> Frame | None:
        """Return the newest frame of a camera that is watched."""
        camera = self._open.get(key)
        return camera.frame if camera is not None else None

    def close(self) -> None:
        """Close every camera. Thread: blocks until their threads have ended."""
        with self._lock:
            self._is_closed = True
            self._wishes.clear()
            self._serve_wishes()
            leaving, self._leaving = self._leaving, []
        for camera in leaving:
            camera.thread.join()

    def _serve_wishes(self) -> None:
        rates: dict[CameraKey, float] = {}
        for keys, rate_hz in self._wishes.values():
            for key in keys:
                rates[key] = max(rates.get(key, 0.0), rate_hz)
        for key in [key for key, camera in self._open.items() if rates.get(key) != camera.rate_hz]:
            camera = self._open.pop(key)
            camera.end()
            self._leaving.append(camera)
        self._leaving = [camera for camera in self._leaving if camera.thread.is_alive()]
        for key, rate_hz in rates.items():
            if key not in self._open:
                self._open[key] = _Camera(self._fleet, key, rate_hz, self._on_frame)


class _Camera:
    """Reads one camera in a thread of its own."""

    def __init__(self, fleet: Fleet, key: CameraKey, rate_hz: float, on_frame: Callable[[], None]) -> None:
        self.rate_hz = rate_hz
        self.frame = Frame()
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
        stream = self._stream
        if stream is not None:
            stream.close()

    def _read(self) -> None:
        while not self._is_over:
            try:
                self._follow()
            except (ArgumentError, UnsupportedError) as error:  # it is no camera, or OpenCV is not there
                self._fail(error)
                return
            except EALError as error:
                if not self._is_over:
                    self._fail(error)
                    REAL_TIME.wait(self._stop, _PAUSE_S)

    def _follow(self) -> None:
        rate_hz = self.rate_hz / self._clock.of_real(1.0)  # streams count seconds of the fleet's clock
        with self._resource.stream(rate_hz, "jpeg") as stream:
            self._stream = stream
            if self._is_over:  # just now, by somebody who has seen no stream to close
                return
            for data in stream:
                self._show(data)

    def _show(self, data: EALData) -> None:
        stamp_s = data.stamp_s if data.stamp_s is not None else self._clock.now()
        if stamp_s == self.frame.stamp_s and self.frame.error is None:
            return  # the camera says itself that it is the same picture as before
        jpeg = encode_image(data, "jpeg")
        checksum = zlib.crc32(jpeg)
        is_same = checksum == self._checksum and self.frame.same_since_s is not None
        self._checksum = checksum
        since_s = self.frame.same_since_s if is_same else stamp_s
        self.frame = Frame(self.frame.number + 1, jpeg, stamp_s, since_s)
        self._on_frame()

    def _fail(self, error: EALError) -> None:
        last = self.frame
        self.frame = Frame(
            last.number + 1, last.jpeg, last.stamp_s, last.same_since_s, error.message or error_text(error)
        )
        self._on_frame()
