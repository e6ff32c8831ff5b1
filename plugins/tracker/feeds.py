"""Where the pictures of a tracker come from: a source of the plugin `camera`, or a simulated camera."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from eal_actors.plugin import FleetServices, NotReadyError, PluginContext, PluginError

from ..camera.reader import ReaderOptions, SourceReader
from ..camera.source import PictureSource
from .detector import Detection, Found
from .settings import SIMULATED, CameraSettings

_SLACK_S = 1e-6
Image: TypeAlias = NDArray[np.uint8]


class PictureFeed(ABC):
    """Gives the newest picture and the time of its exposure. Thread: any."""

    @abstractmethod
    def newest(self) -> tuple[Image, float]:
        """Return blue, green and red, (height, width, 3), and seconds of the fleet's clock. Does not wait for one.

        Raises:
            NotReadyError: the camera is lost, frozen, or at its end.
        """

    def known(self) -> tuple[Found, float] | None:
        """Return the markers in view and their time where they are known without a picture, else None."""
        return None

    def note(self, found: Found, stamp_s: float) -> None:  # noqa: B027  # only simulated cameras can repeat themselves
        """Note what was found in a picture, for a run that repeats this one."""

    def why_not_ready(self) -> str | None:
        """Return why there is no picture now, or None."""
        return None

    @property
    def awaits_first(self) -> bool:
        """Whether its first picture is still to come."""
        return False

    def close(self) -> None:  # noqa: B027  # most feeds have nothing to close
        """Close the camera."""


class SourceFeed(PictureFeed):
    """Pictures that a thread reads from a camera, a stream or files.

    Args:
        reader: reads them; started here.
        latency_s: from the middle of an exposure to the arrival of its picture.
    """

    def __init__(self, reader: SourceReader, latency_s: float) -> None:
        self._reader = reader
        self._latency_s = latency_s
        reader.start()

    @override
    def newest(self) -> tuple[Image, float]:
        picture = self._reader.latest()
        return picture.image, picture.stamp_s - self._latency_s

    @override
    def why_not_ready(self) -> str | None:
        return self._reader.why_not_ready()

    @property
    @override
    def awaits_first(self) -> bool:
        if self._reader.why_not_ready() is not None:
            return False
        try:
            self._reader.latest()
        except NotReadyError:
            return True
        return False

    @override
    def close(self) -> None:
        self._reader.close()


class SimulatedFeed(PictureFeed):
    """Pictures of a simulated world.

    Args:
        name: its name in the fleet, for the log of pictures.
        services: have the fleet's clock, and perhaps that log.
        fps: pictures are at least 1 / fps apart; None for a picture of the moment of each call.
        is_drawn: markers are searched in pictures; if not, the world tells where they are in view.
    """

    def __init__(
        self, camera: Any, name: str, services: FleetServices, fps: float | None, *, is_drawn: bool = True
    ) -> None:
        self._camera = camera
        self._name = name
        self._services = services
        self._period_s = 1.0 / fps if fps else 0.0
        self._is_drawn = is_drawn
        self._last: tuple[Image, float] | None = None
        self._last_known: tuple[Found, float] | None = None

    @override
    def newest(self) -> tuple[Image, float]:
        if self._last is None or self._is_due(self._last[1]):
            self._last = self._camera.frame()
        return self._last

    @override
    def known(self) -> tuple[Found, float] | None:
        if not self._is_drawn and (self._last_known is None or self._is_due(self._last_known[1])):
            markers, stamp_s = self._camera.markers()
            self._last_known = Found([Detection(*marker) for marker in markers], is_whole=True), stamp_s
        elif self._is_drawn and all(self._is_due(last[1]) for last in (self._last, self._last_known) if last):
            self._last_known = self._repeated()
        return self._last_known

    def _repeated(self) -> tuple[Found, float] | None:
        """Return what another run found in the picture of now, if its past is repeated."""
        log = self._services.picture_log
        if log is None or not log.has_past:
            return None
        stamp_s = self._camera.instant_s()
        found = log.find(self._name, stamp_s)
        return None if found is None else (Found.from_json(found), stamp_s)

    @override
    def note(self, found: Found, stamp_s: float) -> None:
        if self._is_drawn and (log := self._services.picture_log) is not None:
            log.add(self._name, stamp_s, found.to_json())

    def _is_due(self, last_s: float) -> bool:
        return self._services.clock.now() >= last_s + self._period_s - _SLACK_S


def open_feed(context: PluginContext, name: str, settings: CameraSettings, *, is_drawn: bool = True) -> PictureFeed:
    """Open the pictures of a camera. An unplugged camera is no error: it is not ready.

    Raises:
        PluginError: there is no such simulated camera, or a file or folder is missing or unreadable.
    """
    if str(settings.source).startswith(SIMULATED):
        camera = context.simulated_camera(str(settings.source))
        place = f"{context.robot}/{name}"
        return SimulatedFeed(camera, place, context.services, settings.fps, is_drawn=is_drawn)
    source = PictureSource.of(settings.source)
    opener = source.opener(loop=settings.loop, fps=settings.fps, fourcc=settings.fourcc, timeout_s=settings.timeout_s)
    if not source.kind.is_live:
        try:
            if not Path(source.address).exists():
                raise OSError(f"does not exist; the working directory is {Path.cwd()}")
            opener().release()
        except OSError as error:
            raise PluginError(f"cameras.{name}: source {source.name!r}: {error}") from error
    width, height = settings.lens.size_px
    size = {"width": width, "height": height} if source.kind.is_live else {}
    options = ReaderOptions(
        name=source.name,
        patience_s=settings.timeout_s,
        wishes={**size, **({"fps": settings.fps} if settings.fps and source.kind.is_live else {})},
        place={"robot": context.robot, "camera": name},
    )
    return SourceFeed(SourceReader(opener, options, context.clock), settings.latency_s)
